"""What a reader finds in a file, whatever its format."""

from __future__ import annotations

from typing import NamedTuple

from ahnn.data.files import epochs, frame_names
from ahnn.data.files.samples import Track
from ahnn.data.files.table import Place
from ahnn.data.files.units import unit
from ahnn.types import Units


class Column(NamedTuple):
    """What a column of a file was taken for.

    Attributes:
        name: of the column.
        role: time, id, position, velocity, momentum, control or left out.
        unit: of its numbers, or the clock of its epochs; "" without.
    """

    name: str
    role: str
    unit: str = ""


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
        columns: what each column was taken for; none where the format says it.
        controls: names of the columns of numbers set from outside; tracks have them.
        linear: whether controls are interpolated linearly between samples; else they are held.
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
    columns: tuple[Column, ...] = ()
    controls: tuple[str, ...] = ()
    linear: bool = False

    @property
    def measured_controls(self) -> tuple[str, ...]:
        """Names of the controls with their units, such as `u [N]`."""
        units = {column.name: column.unit for column in self.columns}
        return tuple(f"{name} [{units[name]}]" if units.get(name) else name for name in self.controls)


def joined(parts: list[Content], places: list[Place]) -> Content:
    """Return the segments of a file as one content, its times from the first epoch.

    Args:
        parts: of one frame, centre and time system each.
        places: of the segments.

    Raises:
        UserError: segments that differ in them.
    """
    first = parts[0]
    names = [part.frame.split(", ") for part in parts]
    for place, found, part in zip(places, names, parts, strict=True):
        for what, here, other in zip(("frame", "center", "time_system"), names[0], found, strict=False):
            if here != other:
                remedy = (
                    frame_names.remedy(first.frame, part.frame) if what == "frame" else "Convert one of them"
                )
                place.refuse(f"{what} {here} in each segment", other, remedy)
    start = min(part.epoch or 0 for part in parts)
    tracks = tuple(track for part in parts for track in shifted(part, start))
    return first._replace(tracks=tracks, epoch=start)


def since_first(contents: list[Content]) -> list[Content]:
    """Return contents whose times count from the first of their epochs, which is added to their frame."""
    known = [content.epoch for content in contents if content.epoch is not None]
    return [counted(content, min(known)) if known else content for content in contents]


def counted(content: Content, first: int) -> Content:
    """Return content whose times count from an epoch, where they do not count from nothing."""
    if content.epoch is None:
        return content
    tracks = shifted(content, first)
    epoch = f"from {epochs.spelled(first, utc=content.clock == 'UTC')}"
    frame = f"{content.frame}, {epoch}" if content.frame else epoch
    return content._replace(tracks=tracks, epoch=first, frame=frame)


def shifted(content: Content, first: int) -> tuple[Track, ...]:
    """Return the tracks of content that has an epoch, their times from another one."""
    shift = ((content.epoch or 0) - first) / epochs.SECOND / unit(content.units.time).size
    return tuple(track._replace(times=track.times + shift) for track in content.tracks)
