"""Parsing of numeric cells, and the error for invalid lines."""

from __future__ import annotations

import math
from typing import Any

MISSING = frozenset(("", "nan", "na", "null", "none"))


class BadLine(ValueError):
    """Invalid measurement line; the message states the expected and received content."""


def is_missing(cell: Any) -> bool:
    """Return whether a cell is empty."""
    return cell is None or (isinstance(cell, str) and cell.lower() in MISSING)


def number(cell: Any, name: str) -> float:
    """Parse the number in a cell, NaN if it is missing.

    Raises:
        BadLine: the cell contains anything else, or infinity.
    """
    if is_missing(cell):
        return math.nan
    try:
        if isinstance(cell, bool) or (isinstance(cell, str) and "_" in cell):
            raise ValueError  # noqa: TRY301 - Python parses both as numbers
        value = float(cell)
    except (TypeError, ValueError, OverflowError):
        value = math.inf
    if math.isinf(value):
        message = f"{name}: expected a finite number; received {str(cell)[:40]!r}"
        raise BadLine(message)
    return value
