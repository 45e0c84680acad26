"""Chi-square gating of improbable measurements."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.numbers import chi_square_quantile


class Gate(NamedTuple):
    """Chi-square gate on complete measurement rows.

    Attributes:
        probability: a row is rejected when its NIS exceeds this quantile of the chi-square distribution.
        patience: number of consecutive rejections that lead to `Status.DIVERGED`.
        reopens: whether filters of streams then widen the belief instead, see `ahnn.estimation.reopening`.
    """

    probability: float = 0.9999
    patience: int = 5
    reopens: bool = False


def check_gate(gate: Gate | None, who: str) -> None:
    """Validate a gate; None means no gate.

    Raises:
        ValueError: the probability is not in (0, 1), or the patience not an integer of at least 1; the
            message begins with `who`.
    """
    if gate is None:
        return
    numbers = isinstance(gate, Gate) and all(isinstance(value, int | float) for value in gate)
    fits = numbers and 0.0 < gate.probability < 1.0 and 1.0 <= gate.patience < torch.inf
    if not fits or gate.patience % 1 != 0:
        message = (
            f"{who}: expected a Gate(probability in (0, 1), patience a whole number >= 1); received {gate!r}"
        )
        raise ValueError(message)


@cache
def thresholds(gate: Gate, width: int, device: torch.device | None = None) -> Tensor:
    """Return the largest accepted NIS, (M + 1,), by the number of available components.

    Args:
        gate: gate for complete rows.
        width: number of components M.
        device: device of the result.
    """
    values = [0.0, *(_quantile(gate.probability, n) for n in range(1, width + 1))]
    with torch.inference_mode(mode=False):  # cached, so it must also work with autograd
        return torch.tensor(values, dtype=torch.float64, device=device)


@cache
def _quantile(probability: float, degrees: int) -> float:
    return chi_square_quantile(probability, degrees)
