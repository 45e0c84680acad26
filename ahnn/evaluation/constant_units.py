"""Units of learned physical constants, from those of the space."""

from __future__ import annotations

import re

from ahnn.data.files.units import is_unit, product
from ahnn.types import Space

MU = re.compile(r"(.*\.)?mu(\[\d+\])?")
FRICTION = re.compile(r"friction\.(coefficient|matrix)(\[\d+\])?")


def constant_unit(name: str, space: Space) -> str:
    """Return the unit of a learned constant, such as `km^3/s^2` of mu; "" without one, or if it is not known.

    A gravitational parameter is a length cubed per time squared. Friction is a force over a velocity, that is
    an energy times a time over a squared position; an angle has no unit.

    Args:
        name: name of the constant (`ahnn.uncertainty.Constant`).
        space: space of the states.
    """
    length, time = space.units.position, space.units.time
    found = ""
    if MU.fullmatch(name):
        found = product(length, length, length, f"1/{time}", f"1/{time}")
    elif FRICTION.fullmatch(name):
        energy, below = space.units.energy, () if length == "rad" else (f"1/{length}",) * 2
        known = energy == "1" or is_unit(energy)
        found = (
            product(energy, time, *below) if known else f"{energy} {time}{f'/{length}^2' if below else ''}"
        )
    return "" if found == "1" else found
