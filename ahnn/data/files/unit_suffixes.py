"""Units at the end of column names: `t_s`, `x_km`, `vx_km_s` and `theta_deg` are t [s], x [km] and so on."""

from __future__ import annotations

import re

from ahnn.data.files.table import Header
from ahnn.data.files.units import ANGLE, LENGTH, NONE, TIME, unit

OF_TIMES = re.compile(r"(?P<stem>t|time)_(?P<unit>[A-Za-z]+)", re.IGNORECASE)
OF_POSITIONS = re.compile(
    r"(?P<stem>(sd_)?(([xyz]|q\d*)|(theta|phi|psi|alpha|angle)_?\d*))_(?P<unit>[A-Za-z]+)", re.IGNORECASE
)
OF_RATES = re.compile(
    r"(?P<stem>(sd_)?((v|vel|velocity)_?([xyz]|q?\d+)|[xyz]_?dot|omega_?\d*))_(?P<unit>[A-Za-z]+_[A-Za-z]+)",
    re.IGNORECASE,
)
RATES = (LENGTH[0], LENGTH[1], -1, LENGTH[3]), (ANGLE[0], ANGLE[1], -1, ANGLE[3])
DIMENSIONS = ((OF_TIMES, (TIME,)), (OF_POSITIONS, (LENGTH, ANGLE)), (OF_RATES, RATES))
"""Patterns of names, and the dimensions that the units behind them may have."""


def with_suffixes(header: Header) -> Header:
    """Return a header in which units at the end of usual names stand in place of missing units.

    Other names are unchanged, such as `x_m2`, and so is a name whose stem is another column.
    """
    parts = [split(name) if own is None else (name, own) for name, own in zip(*header, strict=True)]
    names = [name for name, _ in parts]
    if len({*names}) < len(names):
        return header
    return Header(tuple(names), tuple(own for _, own in parts))


def split(name: str) -> tuple[str, str | None]:
    """Return the stem and the unit of a column name; the whole name and None without a unit."""
    for pattern, dimensions in DIMENSIONS:
        if found := pattern.fullmatch(name):
            text = found["unit"].replace("_", "/")
            return (found["stem"], text) if dimension_of(text) in dimensions else (name, None)
    return name, None


def dimension_of(text: str) -> tuple[int, ...]:
    """Return the dimension of a unit, that of a pure number for other texts."""
    try:
        return unit(text).dimension
    except ValueError:
        return NONE.dimension
