"""Numbers as users have them, turned into tensors, and checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Numbers = Tensor | NDArray[Any] | Sequence[Any] | float
"""Numbers as users have them: a tensor, an array, nested sequences or one number."""


def in_percent(fraction: float) -> str:
    """Return a fraction in percent, in two digits or as a whole number, and never with an exponent."""
    value = 100 * fraction
    if 0 < value < 0.01:
        return "less than 0.01 %"
    return f"{value:.2g} %" if value < 9.95 else f"{value:.0f} %"


def as_float64(value: Numbers, who: str, device: torch.device | None = None) -> Tensor:
    """Return real numbers of any shape as a float64 tensor; gradients flow through it.

    Raises:
        ValueError: if they are no numbers, complex, or not of a rectangular shape; begins with `who`.
    """
    try:
        # A cast would drop the imaginary part.
        if not (value.is_complex() if isinstance(value, Tensor) else np.iscomplexobj(value)):
            return torch.as_tensor(value, dtype=torch.float64, device=device)
        expected = "real numbers"
    except (TypeError, ValueError, RuntimeError):
        expected = "numbers in a tensor, an array or nested lists"
    message = f"{who}: expected {expected}; received {described(value)}"
    raise ValueError(message)


def described(value: object) -> str:
    """Return the type of a value for a message, the dtype if it is complex, and the shape if it has one."""
    shape, dtype = getattr(value, "shape", None), str(getattr(value, "dtype", ""))
    kind = f"{type(value).__name__} of {dtype}" if "complex" in dtype else type(value).__name__
    return kind + ("" if shape is None else f" {tuple(shape)}")


def chi_square_quantile(probability: float, degrees: float) -> float:
    """Return what a chi-square variable stays below with a probability.

    By the inverse of the incomplete gamma function: `scipy.stats` takes half a second to import.
    """
    from scipy.special import gammaincinv

    return 2 * float(gammaincinv(degrees / 2, probability))
