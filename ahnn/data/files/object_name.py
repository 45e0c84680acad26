"""Identifier and names of an object."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class ObjectName(NamedTuple):
    """Identifier and names of an object, e.g. of a satellite.

    Attributes:
        id: identifier in tables, e.g. a catalogue number; the number of the trajectory if there is none.
        name: name; "" if there is none besides the identifier.
        designator: international designator, such as 2014-069A; "" if unknown.
    """

    id: str
    name: str = ""
    designator: str = ""

    @property
    def spoken(self) -> str:
        """Name, or the identifier if there is none."""
        return self.name or self.id


def names_by_id(objects: Iterable[ObjectName]) -> dict[str, str]:
    """Return the names of objects that differ from their identifiers."""
    return {one.id: one.name for one in objects if one.name not in ("", one.id)}


def numbered(count: int) -> tuple[ObjectName, ...]:
    """Return objects numbered from 1."""
    return tuple(ObjectName(str(k + 1)) for k in range(count))
