"""Formatting of rows of numbers as text: shortest exact float64 representation, empty cells for NaN."""

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
"""Maximum number of bytes per number, including its separator."""

PART = 10_000
"""Number of rows above which formatting runs in parallel on the available cores."""


@cache
def library() -> ctypes.CDLL | None:
    """Return the C library, or None without a C compiler."""
    source = Path(__file__).with_name("decimals.c")
    return compiled_library(source, {"ahnn_decimals": (N, N, P, P)}, "writing estimates")


def decimal_rows(values: NDArray[np.float64]) -> list[str]:
    """Format numbers (K, C) as K comma-separated rows."""
    found = library()
    if found is None:
        return [",".join(["" if x != x else repr(x) for x in row]) for row in values.tolist()]
    numbers = np.ascontiguousarray(values, dtype=np.float64)
    parts = [numbers[part] for part in slices(len(numbers), PART)]
    return [*chain.from_iterable(each(partial(_spelled, found), parts, torch.device("cpu")))]


def _spelled(found: ctypes.CDLL, numbers: NDArray[np.float64]) -> list[str]:
    """Format rows with the C library."""
    text = np.empty(WIDEST * numbers.size + 1, dtype=np.uint8)
    length = found.ahnn_decimals(*numbers.shape, numbers.ctypes.data, text.ctypes.data)
    return text[:length].tobytes().decode("ascii").split("\n")[:-1]
