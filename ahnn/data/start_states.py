"""Initial states with names, times, reference and covariances, whatever their source."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from ahnn.data.files import units
from ahnn.data.files.epochs import SECOND
from ahnn.data.files.object_name import ObjectName, numbered
from ahnn.data.reference import Reference

UNKNOWN = "UNKNOWN"
"""Identifier and name, in an ephemeris message, of the only object if neither is known."""


class Starts(NamedTuple):
    """Initial states of predictions or assimilations.

    Attributes:
        objects: names of the objects.
        states: (B, D) states in the units of the space.
        times: (B,) times of the states, in its unit of time.
        reference: reference of positions and times, if specified by the file.
        covariances: (B, D, D) covariances, or None if unknown.
        since: times (B,) and states (B, D) to which the covariances belong, if they are earlier ones; None if
            the covariances belong to `states`.
    """

    objects: tuple[ObjectName, ...]
    states: Tensor
    times: Tensor
    reference: Reference = Reference()
    covariances: Tensor | None = None
    since: tuple[Tensor, Tensor] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Identifiers of the objects."""
        return tuple(one.id for one in self.objects)

    def known(self) -> dict[str, ObjectName]:
        """Return the objects by their identifiers; empty if they are only numbered."""
        numbers = self.objects == numbered(len(self.objects))
        return {} if numbers else {one.id: one for one in self.objects}

    def first_time(self, unit: str) -> str:
        """Return the time of the first state in words: its epoch, or a number in a unit of time."""
        time, reference = float(self.times[0]), self.reference
        if reference.epoch is None:
            return f"t = {time:g} {unit}"
        return reference.spelled(round(time * units.unit(unit).size * SECOND))
