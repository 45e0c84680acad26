"""Numbers as users have them, turned into tensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor

Numbers = Tensor | NDArray[Any] | Sequence[Any] | float
"""Numbers as users have them: a tensor, an array, nested sequences or one number."""


def as_float64(value: Numbers, who: str, device: torch.device | None = None) -> Tensor:
    """Return numbers of any shape as a float64 tensor.

    Raises:
        ValueError: if they are no numbers, or not of a rectangular shape; begins with `who`.
    """
    try:
        return torch.as_tensor(value, dtype=torch.float64, device=device)
    except (TypeError, ValueError, RuntimeError) as error:
        message = f"{who}: expected numbers in a tensor, an array or nested lists, got {described(value)}"
        raise ValueError(message) from error


def described(value: object) -> str:
    """Return the type of a value for a message, and its shape if it has one."""
    shape = getattr(value, "shape", None)
    return type(value).__name__ + ("" if shape is None else f" {tuple(shape)}")
