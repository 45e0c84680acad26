"""Parsing of numeric cells, and the error for invalid lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ahnn.arguments import nearest
from ahnn.errors import UserError

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


def require_object_column(objects: str, cells: Sequence[str]) -> None:
    """Raise UserError if the cells of a header lack the column that `objects=` names, if it names one."""
    names = [cell.partition("[")[0].strip() for cell in cells]
    if objects and objects not in names:
        message = f"objects: expected the name of a column; received {objects!r}{nearest(objects, names)}"
        raise UserError(message)


def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Build a JSON object from pairs; raises ValueError for duplicate keys."""
    found = dict(pairs)
    if len(found) < len(pairs):
        message = "a duplicate key"
        raise ValueError(message)
    return found
