"""What a reader finds in a file, whatever its format."""

from __future__ import annotations

from typing import NamedTuple

from ahnn.data.files import epochs
from ahnn.data.files.samples import Track
from ahnn.data.files.units import unit
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
        clock: of the epoch, such as UTC.
        time: name of the column of the times.
        head: number of the line that names the columns; 0 where none does.
    """

    positions: tuple[str, ...]
    rates: tuple[str, ...]
    momenta: bool
    units: Units
    frame: str
    tracks: tuple[Track, ...]
    epoch: int | None = None
    clock: str = ""
    time: str = "EPOCH"
    head: int = 0


def since_first(contents: list[Content]) -> list[Content]:
    """Return contents whose times count from the first of their epochs, which is added to their frame."""
    known = [content.epoch for content in contents if content.epoch is not None]
    return [counted(content, min(known)) if known else content for content in contents]


def counted(content: Content, first: int) -> Content:
    """Return content whose times count from an epoch, where they do not count from nothing."""
    if content.epoch is None:
        return content
    shift = (content.epoch - first) / epochs.SECOND / unit(content.units.time).size
    tracks = tuple(track._replace(times=track.times + shift) for track in content.tracks)
    epoch = f"from {epochs.spelled(first, utc=content.clock == 'UTC')}"
    frame = f"{content.frame}, {epoch}" if content.frame else epoch
    return content._replace(tracks=tracks, epoch=first, frame=frame)
