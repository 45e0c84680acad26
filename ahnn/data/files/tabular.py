"""Conversion of sample tables, one sample per row, to file content."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from ahnn.data.files import epochs
from ahnn.data.files.columns import BESIDE, Roles, is_deviation, roles
from ahnn.data.files.content import CANONICAL, Column, Content
from ahnn.data.files.frame_names import canonical
from ahnn.data.files.frames import TO_TT
from ahnn.data.files.samples import Array, Track, by_id, ordered
from ahnn.data.files.sidecar import LINEAR, Sidecar
from ahnn.data.files.table import (
    FINITE,
    LARGEST,
    MISSING,
    POINT,
    Fault,
    Header,
    Note,
    Place,
    Remark,
    Sheet,
    number,
    refuse,
)
from ahnn.data.files.unit_factors import Scales, scales
from ahnn.data.files.unwrapped_angles import unwrapped

SHOWN = 8
"""Number of unused standard deviations and covariances that are named."""
NOTATION = "Write dates as year-month-day, which is unambiguous"
NOT_A_DATE = (
    "Write dates as year-month-day, check the order of the columns, or name a unit of time such as [s]"
)


def of_sheet(sheet: Sheet, sidecar: Sidecar, *, of_starts: bool = False, note: Note = refuse) -> Content:
    """Convert a table to content.

    Args:
        sheet: columns of the table, with the units of its sidecar.
        sidecar: its sidecar.
        of_starts: whether only initial states are read, whose standard deviations are used elsewhere.
        note: callback for cells that are not numbers, and times that do not increase.

    Raises:
        UserError: an invalid header (the message gives row and column), or an error raised by `note`.
    """
    place, header = sheet.place, sheet.header
    found = roles(header, sidecar.columns, place)
    say_unused(header, found, place, note, of_starts=of_starts)
    if not len(sheet.rows):
        place.refuse("a row for each sample", "only a header")
    table = tracks_of(sheet, found, (*found.positions, *found.rates), note)
    clock, alone = table.clock, len(table.tracks) == 1
    factors = np.array((*table.by.positions, *table.by.rates))
    tracks = (track._replace(values=track.values * factors) for track in table.tracks)
    tracks = tuple(entitled(track, sidecar.objects, alone=alone) for track in tracks)
    positions, rates = (tuple(header.names[i] for i in columns) for columns in (found.positions, found.rates))
    momenta, head, frame = found.kind == "momenta", place.row, canonical(sidecar.frame)
    controls, linear = tuple(header.names[i] for i in found.controls), sidecar.controls == LINEAR
    units = [clock if i == found.time and clock else unit or "" for i, unit in enumerate(header.units)]
    columns = tuple(
        Column(name, found.of(i), unit)
        for i, (name, unit) in enumerate(zip(header.names, units, strict=True))
    )
    if (general := sidecar.mass == CANONICAL) and not momenta:
        place.refuse(f"momenta, since the sidecar states mass: {CANONICAL}", ", ".join(rates) or "positions")
    about = table.epoch, clock, header.names[found.time], head, columns, controls, linear, general
    return unwrapped(Content(positions, rates, momenta, table.by.units, frame, tracks, *about), note)


class TableTracks(NamedTuple):
    """Columns of a table as trajectories.

    Attributes:
        tracks: trajectories with increasing times, and values in the units of the file.
        by: factors that convert the states.
        epoch: epoch of time zero in the time scale `clock`; None for numeric times.
    """

    tracks: tuple[Track, ...]
    by: Scales
    epoch: int | None
    clock: str


def tracks_of(sheet: Sheet, found: Roles, columns: Sequence[int], note: Note = refuse) -> TableTracks:
    """Return the values of some columns by trajectory; arguments and errors as in `of_sheet`."""
    header, place, file = sheet.header, sheet.place, sheet.place.file
    name, times, clock, epoch = header.names[found.time], None, "", None
    if are_epochs(sheet.columns[found.time]):
        header, clock = with_clock(header, found.time, place)
        times, epoch = elapsed(sheet, found.time, clock, note)
    elif (scale := header.units[found.time]) in TO_TT:
        received = repr(str(sheet.columns[found.time][0]))
        expected = f"a date, since the header names the time scale {scale}"
        Place(file, int(sheet.rows[0]), name).refuse(expected, received, NOT_A_DATE)
    by = scales(header, found, place)
    if times is None:
        times = numbers(sheet, found.time, note)
    values = np.stack([numbers(sheet, column, note) for column in columns], axis=1)
    whole = Track("", file, sheet.rows, times * by.time, values, controls_of(sheet, found, note))
    spelled = str if epoch is None else partial(dated, epoch=epoch, clock=clock)
    tracks = trajectories(sheet, found.id, whole, note)
    return TableTracks(tuple(ordered(track, name, note, spelled) for track in tracks), by, epoch, clock)


def dated(time: float, epoch: int, clock: str) -> str:
    """Format a time in seconds since an epoch, to a microsecond."""
    return epochs.spelled(epoch + round(1e6 * time) * epochs.SECOND // 10**6, utc=clock == "UTC")


def entitled(track: Track, objects: dict[str, str], *, alone: bool) -> Track:
    """Return a track with the name that a sidecar gives its object.

    It also identifies the object of the only track of a table without ids.
    """
    if alone and not track.name and len(objects) == 1:
        ((name, title),) = objects.items()
        return track._replace(name=name, title=title)
    return track._replace(title=objects.get(track.name, ""))


def controls_of(sheet: Sheet, found: Roles, note: Note) -> Array | None:
    """Return the controls of each row, (T, m), without conversion; missing ones are faults."""
    if not found.controls:
        return None
    columns = [numbers(sheet, column, note) for column in found.controls]
    for column, values in zip(found.controls, columns, strict=True):
        for k in np.flatnonzero(np.isnan(values)):
            where = Place(sheet.place.file, int(sheet.rows[k]), sheet.header.names[column])
            note(Fault(where, "a control in each row", "none", "Repeat the value that is held"))
    return np.stack(columns, axis=1)


def say_unused(header: Header, found: Roles, place: Place, note: Note, *, of_starts: bool) -> None:
    """Report unused columns; starts use standard deviations and need nothing else of our own tables."""
    unused = [name for i, name in enumerate(header.names) if found.of(i) == "not used"]
    deviations = [name for name in unused if is_deviation(name)]
    known = BESIDE if of_starts else ()
    if others := [name for name in unused if name not in (*deviations, *known)]:
        note(Remark(place, f"not used, since the sidecar does not name them: {', '.join(others)}"))
    if deviations and not of_starts:
        more = f" and {len(deviations) - SHOWN} more" if len(deviations) > SHOWN else ""
        what = f"{', '.join(deviations[:SHOWN])}{more}: used for a start, but not for training"
        remedy = "For training, set one standard deviation for all samples: sensor=recorded data.noise=..."
        note(Remark(place, what, remedy, "warning"))


def trajectories(sheet: Sheet, column: int | None, whole: Track, note: Note) -> list[Track]:
    """Return a track for each id; rows without id are reported to `note` and skipped."""
    if column is None:
        return [whole]
    name, file = sheet.header.names[column], sheet.place.file
    ids = [str(cell) for cell in sheet.columns[column]]
    missing = np.array([one.lower() in MISSING for one in ids], dtype=bool)
    for row in sheet.rows[missing]:
        note(Fault(Place(file, int(row), name), "the name of a trajectory", "none", "Name it in each row"))
    return by_id([one for one in ids if one.lower() not in MISSING], whole.part(np.flatnonzero(~missing)))


def numbers(sheet: Sheet, column: int, note: Note) -> Array:
    """Return a column in the unit of the file, NaN for empty or invalid cells.

    Raises:
        UserError: a decimal comma, since the other cells of the file probably contain it as well.
    """
    cells, name, file = sheet.columns[column], sheet.header.names[column], sheet.place.file
    if isinstance(cells, np.ndarray):
        beyond = np.abs(cells) > LARGEST
        for k in np.flatnonzero(beyond):
            note(Fault(Place(file, int(sheet.rows[k]), name), FINITE, str(cells[k])))
        return np.where(beyond, np.nan, cells)
    found = np.full(len(cells), np.nan)
    for k, (row, cell) in enumerate(zip(sheet.rows.tolist(), cells, strict=True)):
        try:
            found[k] = number(cell, Place(file, row, name))
        except Fault as fault:
            if fault.remedy == POINT:
                raise
            note(fault)
    return found


def are_epochs(cells: Sequence[str] | Array) -> bool:
    """Return whether the first non-empty cell is a date or a time of day, in any notation."""
    if isinstance(cells, np.ndarray):
        return False
    first = next((cell for cell in cells if cell.lower() not in MISSING), "")
    return epochs.DATE.match(first) is not None


def with_clock(header: Header, time: int, place: Place) -> tuple[Header, str]:
    """Return a header with times in seconds, and the time scale of its epochs; UTC by default."""
    clock = header.units[time] or "UTC"
    if clock not in TO_TT:
        place._replace(column=header.names[time]).refuse(
            f"a time scale for the epochs: one of {', '.join(TO_TT)}", repr(clock)
        )
    bare = all(unit is None for k, unit in enumerate(header.units) if k != time)
    units = [None if bare else "s" if k == time else unit for k, unit in enumerate(header.units)]
    return header._replace(units=tuple(units)), clock


def elapsed(sheet: Sheet, column: int, clock: str, note: Note) -> tuple[Array, int]:
    """Return the seconds since the first epoch in a column, NaN where missing, and that epoch.

    Raises:
        UserError: the first epoch is in an unsupported notation.
    """
    name, file = sheet.header.names[column], sheet.place.file
    moments: list[int | None] = []
    known = False
    for row, cell in zip(sheet.rows.tolist(), sheet.columns[column], strict=True):
        text = str(cell)
        try:
            moments.append(None if text.lower() in MISSING else epochs.instant(text, utc=clock == "UTC"))
            known |= moments[-1] is not None
        except ValueError as error:
            if not known:
                Place(file, row, name).refuse(str(error), f"{cell!r}, in another notation", NOTATION)
            note(Fault(Place(file, row, name), str(error), repr(cell)))
            moments.append(None)
    start = min((moment for moment in moments if moment is not None), default=0)
    times = [math.nan if moment is None else (moment - start) / epochs.SECOND for moment in moments]
    return np.array(times), start
