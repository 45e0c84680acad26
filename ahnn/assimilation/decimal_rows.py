"""Rows of numbers as text, each the shortest that reads back as the same float64; NaN is an empty cell."""

from __future__ import annotations

import ctypes
from functools import cache, partial
from itertools import chain
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from ahnn.compiled_libraries import NUMBER as N
from ahnn.compiled_libraries import POINTER as P
from ahnn.compiled_libraries import compiled_library
from ahnn.cores import each, slices

WIDEST = 32
"""Bytes that a number takes at most, with what stands behind it."""

PART = 10_000
"""Rows that are written side by side with others, on the cores that there are."""


@cache
def library() -> ctypes.CDLL | None:
    """Return the library, or None where there is no C compiler."""
    source = Path(__file__).with_name("decimals.c")
    return compiled_library(source, {"ahnn_decimals": (N, N, P, P)}, "writing estimates")


def decimal_rows(values: NDArray[np.float64]) -> list[str]:
    """Return the rows of numbers (K, C) as texts, with commas between the numbers."""
    found = library()
    if found is None:
        return [",".join(["" if x != x else repr(x) for x in row]) for row in values.tolist()]
    numbers = np.ascontiguousarray(values, dtype=np.float64)
    parts = [numbers[part] for part in slices(len(numbers), PART)]
    return [*chain.from_iterable(each(partial(_spelled, found), parts, torch.device("cpu")))]


def _spelled(found: ctypes.CDLL, numbers: NDArray[np.float64]) -> list[str]:
    """Return the rows of numbers as the library writes them."""
    text = np.empty(WIDEST * numbers.size + 1, dtype=np.uint8)
    length = found.ahnn_decimals(*numbers.shape, numbers.ctypes.data, text.ctypes.data)
    return text[:length].tobytes().decode("ascii").split("\n")[:-1]
