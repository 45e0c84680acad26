"""Units in column names: `km/s`, `kg m^2/s`, `deg`, `1`."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

MASS, LENGTH, TIME, ANGLE = (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)
"""Exponents of mass, length, time and angle."""

BASE = {
    **{"kg": (1.0, MASS), "g": (1e-3, MASS), "t": (1e3, MASS)},
    **{"m": (1.0, LENGTH), "km": (1e3, LENGTH), "cm": (1e-2, LENGTH), "mm": (1e-3, LENGTH)},
    **{
        "um": (1e-6, LENGTH),
        "nm": (1e-9, LENGTH),
        "AU": (149597870700.0, LENGTH),
        "au": (149597870700.0, LENGTH),
    },
    **{"ns": (1e-9, TIME), "us": (1e-6, TIME), "ms": (1e-3, TIME), "s": (1.0, TIME), "min": (60.0, TIME)},
    **{"h": (3600.0, TIME), "d": (86400.0, TIME), "day": (86400.0, TIME)},
    **{"rad": (1.0, ANGLE), "deg": (math.pi / 180, ANGLE), "°": (math.pi / 180, ANGLE)},
}
"""Size of each named unit in kg, m, s and rad, and its dimension."""
POWER = re.compile(r"(?P<one>1)|(?P<name>[A-Za-z°]+)((\^|\*\*)?(?P<power>-?\d))?")
RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


class Unit(NamedTuple):
    """Parsed unit.

    Attributes:
        text: text as written.
        size: size in kg, m, s and rad.
        dimension: exponents of mass, length, time and angle.
    """

    text: str
    size: float
    dimension: tuple[int, ...]

    def per(self, other: Unit) -> Unit:
        """Return this unit divided by another."""
        dimension = tuple(a - b for a, b in zip(self.dimension, other.dimension, strict=True))
        return Unit(f"{self.text}/{other.text}", self.size / other.size, dimension)


NONE = Unit("1", 1.0, (0, 0, 0, 0))


def unit(text: str) -> Unit:
    """Parse a unit; all factors after a slash divide.

    Raises:
        ValueError: an unknown name, or not a product of powers.
    """
    size, dimension = 1.0, [0, 0, 0, 0]
    above, *below = (text.strip() or "1").translate(RAISED).split("/")
    for sign, part in ((1, above), *((-1, part) for part in below)):
        for factor in re.split(r"[\s·]+|(?<!\*)\*(?!\*)", part.strip()):
            found = POWER.fullmatch(factor)
            if found is None or not (found["one"] or found["name"] in BASE):
                message = f"a product of powers of {', '.join(BASE)}"
                raise ValueError(message)
            own, exponents = BASE[found["name"]] if found["name"] else (1.0, NONE.dimension)
            power = sign * int(found["power"] or 1)
            size *= own**power
            dimension = [d + power * e for d, e in zip(dimension, exponents, strict=True)]
    return Unit(text.strip() or "1", size, tuple(dimension))


def product(*texts: str) -> str:
    """Return the product of units as a text, such as `km^2/s` of `km` and `km/s`; others are only joined."""
    powers: dict[str, int] = {}
    for text in texts:
        try:
            unit(text)
        except ValueError:
            return " * ".join(f"({one})" if set(one) & set(" /") else one for one in texts)
        above, *below = text.translate(RAISED).split("/")
        for sign, part in ((1, above), *((-1, part) for part in below)):
            for found in POWER.finditer(part):
                if name := found["name"]:
                    powers[name] = powers.get(name, 0) + sign * int(found["power"] or 1)
    over = [_raised(name, power) for name, power in powers.items() if power > 0]
    under = [f"/{_raised(name, -power)}" for name, power in powers.items() if power < 0]
    return f"{' '.join(over) or '1'}{''.join(under)}"


def _raised(name: str, power: int) -> str:
    return name if power == 1 else f"{name}^{power}"


def is_unit(text: str) -> bool:
    """Return whether a text is a unit with a dimension."""
    try:
        return unit(text).dimension != NONE.dimension
    except ValueError:
        return False


def factor(theirs: str, ours: str) -> float:
    """Return the conversion factor of a unit to ours; raises ValueError for other dimensions."""
    if theirs == ours:
        return 1.0
    a, b = unit(theirs), unit(ours)
    if a.dimension != b.dimension or a.dimension == NONE.dimension:
        message = f"a unit compatible with {ours}"
        raise ValueError(message)
    return a.size / b.size
