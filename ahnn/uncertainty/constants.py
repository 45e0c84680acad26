"""Learned physical constants, such as friction, with standard deviations."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics


class Constant(NamedTuple):
    """Learned constant.

    Attributes:
        name: name, such as `friction.coefficient`.
        value: value in the units of the system.
        deviation: standard deviation; NaN if the parameter covariance is unknown.
    """

    name: str
    value: float
    deviation: float

    def numbers(self) -> list[float | None]:
        """Return value and deviation, None if unknown, for metrics.json."""
        return [self.value, None if math.isnan(self.deviation) else self.deviation]

    def __str__(self) -> str:
        """Return name, value and deviation, rounded according to the deviation."""
        if not self.deviation > 0:
            return f"{self.name} {self.value:.6g}"
        digits = math.floor(math.log10(abs(self.value) / self.deviation)) + 2 if self.value else 2
        return f"{self.name} {self.value:.{max(2, digits)}g} ± {self.deviation:.2g}"


def learned_constants(dynamics: Dynamics, spread: Tensor | None) -> list[Constant]:
    """Return the learned constants of dynamics, in the order of their parts.

    The method `constants` of a part returns a mapping from names to tensors. Elements of a tensor are
    numbered from 1.

    Args:
        dynamics: float64 dynamics.
        spread: factor (P, R) of the second moment of the parameters, in their order; None if unknown.
    """
    own_copy = copy.deepcopy(dynamics).requires_grad_()
    parameters, found = list(own_copy.parameters()), []
    for path, part in own_copy.named_modules():
        constants: Any = getattr(part, "constants", None)
        if constants is None:
            continue
        own = f"{path.rpartition('.')[2]}." if ".forces." in path else ""
        with torch.enable_grad():
            for name, values in constants().items():
                for k, value in enumerate(values.flatten()):
                    number = f"[{k + 1}]" if values.numel() > 1 else ""
                    deviation = math.nan if spread is None else _deviation(value, parameters, spread)
                    found.append(Constant(f"{own}{name}{number}", float(value.detach()), deviation))
    return found


def _deviation(value: Tensor, parameters: Sequence[Tensor], spread: Tensor) -> float:
    """Return the standard deviation of a number, to first order in the parameters."""
    slopes = torch.autograd.grad(value, parameters, retain_graph=True, materialize_grads=True)
    row = torch.cat([slope.flatten() for slope in slopes])
    return float((row.to(spread) @ spread).norm())
