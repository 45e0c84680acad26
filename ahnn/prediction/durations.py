"""Durations as people write them: `1d`, `90min`, or a number in the unit of time of a space."""

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
    """Return a duration in a unit of time.

    Args:
        value: a number, or one with a unit behind it.
        who: the parameter, for messages.
        base: the unit of time of the space, "1" where numbers have none.

    Raises:
        UserError: it is no duration, or its unit does not fit.
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
    """Return the times (T,) from 0 to a duration, a step apart, the last step shorter where it has to be."""
    require_memory("duration and step", "times", 8.0 * (total / step))  # before it is counted: it may be inf
    count = substeps(total, step)
    times = step * torch.arange(count + 1, dtype=torch.float64)
    times[-1] = total
    return times


def picoseconds(time: float, base: str) -> int:
    """Return a time in the unit of a space as whole picoseconds; without a unit it is taken as seconds."""
    clock = unit(base)
    return round(time * (clock.size if clock.dimension == TIME else 1.0) * SECOND)
