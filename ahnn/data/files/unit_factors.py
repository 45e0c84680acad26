"""Unit conversion of columns: a common position unit, a time unit, and a factor per column."""

from __future__ import annotations

from typing import NamedTuple, NoReturn

from ahnn.data.files.columns import Roles
from ahnn.data.files.table import Header, Place
from ahnn.data.files.units import ANGLE, LENGTH, MASS, NONE, TIME, Unit, unit
from ahnn.types import Units


class Scales(NamedTuple):
    """Conversion factors from a file to a space.

    Attributes:
        units: units of the space, with energies per unit mass.
        time: factor of the times.
        positions, rates: factors of the columns.
    """

    units: Units
    time: float
    positions: tuple[float, ...]
    rates: tuple[float, ...]


def scales(header: Header, roles: Roles, place: Place) -> Scales:
    """Return units and factors: the first position and the first velocity set the units.

    Angles are in rad, so that a momentum divided by the inertia is their rate. Momenta are in kg times the
    unit of the velocities (for angles, kg m^2/s, with the inertia in kg m^2).

    Args:
        header: names and units of the columns.
        roles: roles of the columns.
        place: place of the header.

    Raises:
        UserError: an unknown or incompatible unit, or units for some columns only.
    """
    columns = (roles.time, *roles.positions, *roles.rates)
    without = [i for i in columns if header.units[i] is None]
    if len(without) == len(columns):
        return Scales(Units(), 1.0, (1.0,) * len(roles.positions), (1.0,) * len(roles.rates))
    if without:
        name = header.names[without[0]]
        written = f"Write {name} [s] or {name}_s for seconds, " if without[0] == roles.time else "Use "
        remedy = f"{written}[1] for pure numbers"
        place._replace(column=header.names[without[0]]).refuse(
            "a unit, since other columns have one", "none", remedy
        )
    found = {i: parsed(header, i, place) for i in columns}
    length = found[roles.positions[0]]
    if length.dimension not in (LENGTH, ANGLE, NONE.dimension):
        wrong(header, roles.positions[0], place, "a length, an angle or [1]")
    if length.dimension == ANGLE:
        length = unit("rad")
    positions = tuple(factor(header, found, i, length, place, "the first position") for i in roles.positions)
    clock = found[roles.time]
    if clock.dimension not in (TIME, NONE.dimension):
        wrong(header, roles.time, place, "a time or [1]")
    base = time_unit(found[roles.rates[0]].text, clock) if roles.rates else clock
    speed = length.per(base)
    rate, meaning = speed, f"a velocity ({length.text} per time)"
    if roles.kind == "momenta" and length.dimension != NONE.dimension:
        arm = unit("m^2") if length.dimension == ANGLE else length
        dimension = tuple(m + a - t for m, a, t in zip(MASS, arm.dimension, TIME, strict=True))
        rate = Unit("kg", arm.size / base.size, dimension)
        meaning = f"a momentum, such as [kg {arm.text}/{base.text}]"
    rates = tuple(factor(header, found, i, rate, place, meaning) for i in roles.rates)
    text = "1" if speed.text == "1/1" else speed.text
    units = Units(base.text, length.text, text, energy_unit(length, base))
    return Scales(units, clock.size / base.size, positions, rates)


def parsed(header: Header, column: int, place: Place) -> Unit:
    """Return the unit of a column; raises UserError for an unknown unit."""
    text = header.units[column] or ""
    try:
        return unit(text)
    except ValueError as error:
        place._replace(column=header.names[column]).refuse(f"a unit, {error}", repr(text))


def factor(
    header: Header, found: dict[int, Unit], column: int, wanted: Unit, place: Place, meaning: str
) -> float:
    """Return the conversion factor of a column; raises UserError for another dimension."""
    if found[column].dimension != wanted.dimension:
        wrong(header, column, place, f"the unit of {meaning}")
    return found[column].size / wanted.size


def wrong(header: Header, column: int, place: Place, expected: str) -> NoReturn:
    """Raise UserError for the wrong unit of a column."""
    place._replace(column=header.names[column]).refuse(expected, repr(header.units[column]))


def time_unit(rate: str, clock: Unit) -> Unit:
    """Return the time unit of a rate, so that rates need no conversion; if it has none, the unit of times."""
    last = rate.rpartition("/")[2].strip() if "/" in rate else ""
    try:
        found = unit(last)
    except ValueError:
        return clock
    return found if found.dimension == TIME == clock.dimension else clock


def energy_unit(length: Unit, base: Unit, *, weighed: bool = False) -> str:
    """Return the unit of energies, per unit mass if no mass is stated."""
    if length.dimension in (ANGLE, NONE.dimension):
        weight = "kg m²" if weighed and length.dimension == ANGLE else "1"
        text = weight if base.dimension == NONE.dimension else f"{weight}/{base.text}²"
        return "J" if text == "kg m²/s²" else text
    if weighed and (length.text, base.text) == ("m", "s"):
        return "J"
    return f"{'kg ' if weighed else ''}{length.text}²/{base.text}²"
