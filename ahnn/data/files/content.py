"""What a reader finds in a file, whatever its format."""

from __future__ import annotations

from typing import NamedTuple

from ahnn.data.files.samples import Track
from ahnn.types import Units


class Content(NamedTuple):
    """Tracks of positions, or of positions and their rates, in the units of a space.

    Attributes:
        positions, rates: names of the columns; no rates where they are unknown.
        momenta: whether the rates are momenta, and not velocities.
        units: of the space.
        frame: in which positions are given, "" where nobody said.
        tracks: the trajectories.
        epoch: at which their times are zero (`epochs.instant`); None where times are numbers.
    """

    positions: tuple[str, ...]
    rates: tuple[str, ...]
    momenta: bool
    units: Units
    frame: str
    tracks: tuple[Track, ...]
    epoch: int | None = None
