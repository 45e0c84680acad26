"""Conversion of numeric user input to checked tensors."""

from __future__ import annotations

import operator
from collections.abc import Iterator, Sequence
from numbers import Real
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ahnn.errors import UserError

Numbers = Tensor | NDArray[Any] | Sequence[Any] | float
"""Numeric input: a tensor, an array, nested sequences or one number."""


def in_percent(fraction: float) -> str:
    """Format a fraction in percent, with two digits or as a whole number, never with an exponent."""
    value = 100 * fraction
    if 0 < value < 0.01:
        return "less than 0.01 %"
    return f"{value:.2g} %" if value < 9.95 else f"{value:.0f} %"


def if_few(trajectories: int) -> str:
    """Return ` (only one trajectory)`, or two, for a result over so few; "" otherwise."""
    names = {1: "one trajectory", 2: "two trajectories"}
    return f" (only {names[trajectories]})" if trajectories in names else ""


def as_float64(value: Numbers, who: str, device: torch.device | None = None) -> Tensor:
    """Return real numbers of any shape as a float64 tensor; gradients flow through it.

    Masked entries of an array become NaN. Nested lists may contain tensors and arrays.

    Raises:
        UserError: values that are not real numbers or not rectangular; the message begins with `who`.
    """
    expected = "numbers in a tensor, an array or nested lists"
    try:
        if isinstance(value, Tensor):
            if _is_dense(value) and not value.is_complex():  # a cast would drop the imaginary part
                return value.to(device=device, dtype=torch.float64)
            expected = "real numbers" if value.is_complex() else "numbers in a dense tensor"
        elif _holds_parts(value):
            return torch.stack([as_float64(part, who, device) for part in cast(Sequence[Any], value)])
        elif (array := np.asanyarray(value)).dtype.kind in "fiu" or _all_real(array):
            with np.errstate(over="ignore"):  # more than 64 bits
                numbers = cast(Any, np.ma.asarray(array).astype(np.float64, order="C")).filled(np.nan)
            return torch.from_numpy(np.asarray(numbers)).to(device)
        elif array.dtype.kind == "c":
            expected = "real numbers"
    except (TypeError, ValueError, OverflowError, RuntimeError):
        pass
    wrong = next(_texts(value), None) if isinstance(value, list | tuple) else None
    received = described(value) if wrong is None else f"{wrong!r} among them"
    message = f"{who}: expected {expected}; received {received}"
    raise UserError(message)


def _texts(value: object) -> Iterator[str]:
    """Yield the texts in nested lists and tuples."""
    if isinstance(value, str):
        yield value
    for part in value if isinstance(value, list | tuple) else ():
        yield from _texts(part)


def _is_dense(value: Tensor) -> bool:
    """Return whether a tensor is dense and contains stored numbers."""
    kinds = value.is_meta, value.is_nested, value.is_quantized, value.dtype == torch.bool
    return value.layout is torch.strided and not any(kinds)


def _all_real(array: NDArray[Any]) -> bool:
    """Return whether an array of objects contains only real numbers."""
    return array.dtype == object and all(isinstance(n, Real) and not isinstance(n, bool) for n in array.flat)


def _holds_parts(value: Any) -> bool:
    """Return whether nested lists contain tensors or masked arrays, which numpy does not convert."""
    if not isinstance(value, list | tuple):
        return False
    return any(isinstance(part, Tensor | np.ma.MaskedArray) or _holds_parts(part) for part in value)


def as_count(value: Any, who: str, least: int = 0) -> int:
    """Convert an integer of Python, numpy or torch to int; raises UserError for others, or below `least`."""
    try:
        if (count := operator.index(value)) >= least and not isinstance(value, bool):
            return count
    except TypeError:
        pass
    message = f"{who}: expected a whole number >= {least}; received {value!r}"
    raise UserError(message)


def described(value: object) -> str:
    """Return the type of a value for a message, with its dtype unless float, and its shape if it has one."""
    kind, dtype = type(value).__name__, str(getattr(value, "dtype", "float"))
    shape = None if getattr(value, "is_nested", False) else getattr(value, "shape", None)
    return kind + ("" if "float" in dtype else f" of {dtype}") + ("" if shape is None else f" {tuple(shape)}")


def chi_square_quantile(probability: float, degrees: float) -> float:
    """Return the quantile of a chi-square distribution at a probability.

    Uses the inverse of the incomplete gamma function: `scipy.stats` takes half a second to import.
    """
    from scipy.special import gammaincinv

    return 2 * float(gammaincinv(degrees / 2, probability))


def require_precision(dtype: torch.dtype | None) -> None:
    """Raise UserError for a dtype other than float32 and float64: others are too coarse for motion."""
    if dtype not in (None, torch.float32, torch.float64):
        message = f"dtype: expected torch.float32 or torch.float64; received {dtype}"
        raise UserError(message)
