"""Parsing of durations: `1d`, `90min`, or a number in the time unit of a space."""

from __future__ import annotations

import math
import re

import torch
from torch import Tensor

from ahnn.data.files.epochs import SECOND
from ahnn.data.files.units import TIME, unit
from ahnn.errors import UserError
from ahnn.memory import require_memory
from ahnn.substeps import substeps

AMOUNT = re.compile(r"\s*(?P<number>[\d.]+([eE][+-]?\d+)?)\s*(?P<unit>[A-Za-z]+)\s*")


def duration(value: str | float, who: str, base: str) -> float:
    """Parse a duration and convert it to a unit of time.

    Args:
        value: a number, or a number followed by a unit.
        who: parameter name, for messages.
        base: unit of time of the space, "1" for dimensionless.

    Raises:
        UserError: invalid duration, or an incompatible unit.
    """
    found = AMOUNT.fullmatch(value) if isinstance(value, str) else None
    try:
        amount, own = (float(found["number"]), unit(found["unit"])) if found else (float(value), None)
        clock = unit(base)
    except ValueError:
        amount, own, clock = math.nan, None, unit("1")
    if own is not None and not own.dimension == TIME == clock.dimension:
        amount = math.nan
    if own is not None:
        amount *= own.size / clock.size
    if not 0 < amount < math.inf:
        known = f"such as 90, in {base}, 90min or 1d" if unit(base).dimension == TIME else "such as 90"
        message = f"{who}: expected a positive duration {known}; received {value!r}"
        raise UserError(message)
    return amount


def grid(total: float, step: float) -> Tensor:
    """Return the times (T,) from 0 to a duration in equal steps; the last step may be shorter."""
    require_memory("duration and step", "times", 8.0 * (total / step))  # checked before counting: may be inf
    count = substeps(total, step)
    times = step * torch.arange(count + 1, dtype=torch.float64)
    times[-1] = total
    return times


def picoseconds(time: float, base: str) -> int:
    """Convert a time in the unit of a space to integer picoseconds; dimensionless times are seconds."""
    clock = unit(base)
    return round(time * (clock.size if clock.dimension == TIME else 1.0) * SECOND)
