"""Initial states with names, times, reference and covariances, whatever their source."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from ahnn.data.files import units
from ahnn.data.files.epochs import SECOND
from ahnn.data.reference import Reference

UNKNOWN = "UNKNOWN"
"""Identifier and name, in an ephemeris message, of the only object if neither is known."""


class Starts(NamedTuple):
    """Initial states of predictions or assimilations.

    Attributes:
        names: names of the trajectories; of satellites, their identifiers, such as 2009-012A.
        states: (B, D) states in the units of the space.
        times: (B,) times of the states, in its unit of time.
        reference: reference of positions and times, if specified by the file.
        covariances: (B, D, D) covariances, or None if unknown.
        since: times (B,) and states (B, D) to which the covariances belong, if they are earlier ones; None if
            the covariances belong to `states`.
        titles: names of the objects besides their identifiers, "" where there is none; empty without any.
        designators: their international designators, such as 2014-069A; likewise.
    """

    names: tuple[str, ...]
    states: Tensor
    times: Tensor
    reference: Reference = Reference()
    covariances: Tensor | None = None
    since: tuple[Tensor, Tensor] | None = None
    titles: tuple[str, ...] = ()
    designators: tuple[str, ...] = ()

    def objects(self) -> dict[str, str]:
        """Return the name of each object by its identifier; empty if trajectories are only numbered."""
        if self.names == numbered(len(self.names)) and not any(self.titles):
            return {}
        pairs = zip(self.names, self.titles or self.names, strict=True)
        return {name: title or name for name, title in pairs}

    def first_time(self, unit: str) -> str:
        """Return the time of the first state in words: its epoch, or a number in a unit of time."""
        time, reference = float(self.times[0]), self.reference
        if reference.epoch is None:
            return f"t = {time:g} {unit}"
        return reference.spelled(round(time * units.unit(unit).size * SECOND))


def numbered(count: int) -> tuple[str, ...]:
    """Return names numbered from 1."""
    return tuple(str(k + 1) for k in range(count))
