"""C library of the square-root form."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

from ahnn.compiled_libraries import NUMBER as N
from ahnn.compiled_libraries import POINTER as P
from ahnn.compiled_libraries import REAL as R
from ahnn.compiled_libraries import compiled_library

SIGNATURES = {
    "ahnn_draw": (N, N, P, P, N, P, N, P),
    "ahnn_predict": (N, N, P, P, P, N, P, N, P, P),
    "ahnn_joint": (N, N, N, P, P, N, P, N, P, P, N, P, N, P, P),
    "ahnn_condition": (N, N, N, P, P, P, P, N, P, P, P, P, P, P, P),
    "ahnn_read": (N, N, N, P, P, P, N, P, N, P, P, P, P, P, P, P),
    "ahnn_follow": (
        *(N, N, N, N, P, P, P, P, P, P, P, N, P, N, N, P, P, N, R, P, P, P),
        *(P, P, P, P, P, P, P, P, P, P),
    ),
}
"""Argument types of its functions: addresses and numbers."""


@cache
def library() -> ctypes.CDLL | None:
    """Return the C library, or None without a C compiler; the filter is then slower."""
    return compiled_library(Path(__file__).with_name("members.c"), SIGNATURES, "the filter")
