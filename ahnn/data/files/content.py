"""Format-independent content of a data file."""

from __future__ import annotations

from typing import NamedTuple

from ahnn.data.files import epochs, frame_names
from ahnn.data.files.samples import Track
from ahnn.data.files.table import Place
from ahnn.data.files.units import unit
from ahnn.types import Units

CANONICAL = "canonical"
"""In place of a mass: momenta that are not mass times velocity, as those of coupled angles."""


class Column(NamedTuple):
    """Interpretation of a column.

    Attributes:
        name: name of the column.
        role: time, id, position, velocity, momentum, control or ignored.
        unit: unit of its values, or time scale of its epochs; "" if there is none.
    """

    name: str
    role: str
    unit: str = ""


class Content(NamedTuple):
    """Tracks of positions, or of positions and their rates, in the units of a space.

    Attributes:
        positions, rates: column names; rates are empty if unknown.
        momenta: whether the rates are momenta instead of velocities.
        units: units of the space, with energies per unit mass.
        frame: reference frame of the positions, "" if unspecified.
        tracks: trajectories.
        epoch: epoch of time zero (`epochs.instant`); None for numeric times.
        clock: time scale of the epoch, such as UTC.
        time: name of the time column.
        head: line number of the header; 0 without header.
        columns: interpretation of each column; empty for self-describing formats.
        controls: names of the control columns, whose values are in the tracks.
        linear: whether controls are interpolated linearly between samples instead of held.
        general: whether the momenta are stated not to be mass times velocity.
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
    general: bool = False

    @property
    def stated_momenta(self) -> str:
        """Meaning of the momenta, for messages; "" for velocities."""
        return "" if not self.momenta else CANONICAL if self.general else "mass times velocity"

    @property
    def measured_controls(self) -> tuple[str, ...]:
        """Names of the controls with their units, such as `u [N]`."""
        units = {column.name: column.unit for column in self.columns}
        return tuple(f"{name} [{units[name]}]" if units.get(name) else name for name in self.controls)


def joined(parts: list[Content], places: list[Place]) -> Content:
    """Merge the segments of a file, with times since the first epoch.

    Args:
        parts: contents, each with its frame, centre and time scale.
        places: places of the segments.

    Raises:
        UserError: segments with different frames, centres or time scales.
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
    """Return contents with times counted from the first of their epochs, which is appended to their frame."""
    known = [content.epoch for content in contents if content.epoch is not None]
    return [counted(content, min(known)) if known else content for content in contents]


def counted(content: Content, first: int) -> Content:
    """Shift content to times since an epoch, unless its times have no epoch.

    The epoch appended to the frame names its time scale, unless the frame does.
    """
    if content.epoch is None:
        return content
    tracks = shifted(content, first)
    epoch = f"from {epochs.spelled(first, utc=content.clock == 'UTC')}"
    named = len(content.frame.split(", ")) > 2
    epoch = epoch if named or not content.clock else f"{epoch} {content.clock}"
    frame = f"{content.frame}, {epoch}" if content.frame else epoch
    return content._replace(tracks=tracks, epoch=first, frame=frame)


def shifted(content: Content, first: int) -> tuple[Track, ...]:
    """Return the tracks of content with times counted from another epoch."""
    shift = ((content.epoch or 0) - first) / epochs.SECOND / unit(content.units.time).size
    return tuple(track._replace(times=track.times + shift) for track in content.tracks)
