"""Tables of samples, one a row, as the content of a file."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ahnn.data.files import epochs
from ahnn.data.files.columns import roles
from ahnn.data.files.content import Content
from ahnn.data.files.frames import TO_TT
from ahnn.data.files.samples import Array, Track, by_id, ordered
from ahnn.data.files.scales import scales
from ahnn.data.files.sidecar import Sidecar, with_units
from ahnn.data.files.table import MISSING, Fault, Header, Note, Place, Sheet, number, refuse


def of_sheet(sheet: Sheet, sidecar: Sidecar, *, weighed: bool, note: Note = refuse) -> Content:
    """Return the content of a table.

    Args:
        sheet: its columns.
        sidecar: what stands beside it.
        weighed: whether a mass is stated.
        note: of each cell that is no number, and each time that does not increase.

    Raises:
        UserError: names row and column of what is wrong with the header, or what `note` raises.
    """
    place, file = sheet.place, sheet.place.file
    header = with_units(sheet.header, sidecar, place)
    found = roles(header, sidecar.columns, place)
    if not len(sheet.rows):
        place.refuse("a row for each sample", "a header alone")
    times, clock, epoch = None, "", None
    if are_epochs(sheet.columns[found.time]):
        header, clock = with_clock(header, found.time, place)
        times, epoch = elapsed(sheet, found.time, clock, note)
    by = scales(header, found, place, weighed=weighed)
    if times is None:
        times = numbers(sheet, found.time, note)
    columns = [numbers(sheet, column, note) for column in (*found.positions, *found.rates)]
    values = np.stack(columns, axis=1) * (*by.positions, *by.rates)
    ids = [""] * len(sheet.rows) if found.id is None else [str(name) for name in sheet.columns[found.id]]
    name = header.names[found.time]
    whole = Track("", file, sheet.rows, times * by.time, values)
    tracks = tuple(ordered(track, name, note) for track in by_id(ids, whole))
    positions, rates = (tuple(header.names[i] for i in columns) for columns in (found.positions, found.rates))
    momenta, head = found.kind == "momenta", place.row
    return Content(
        positions, rates, momenta, by.units, sidecar.frame, tracks, epoch, clock, time=name, head=head
    )


def numbers(sheet: Sheet, column: int, note: Note) -> Array:
    """Return a column in the unit of the file, NaN where nothing or no number is."""
    cells, name, file = sheet.columns[column], sheet.header.names[column], sheet.place.file
    if isinstance(cells, np.ndarray):
        for k in np.flatnonzero(np.isinf(cells)):
            note(Fault(Place(file, int(sheet.rows[k]), name), "a finite number", str(cells[k])))
        return np.where(np.isinf(cells), np.nan, cells)
    found = np.full(len(cells), np.nan)
    for k, (row, cell) in enumerate(zip(sheet.rows.tolist(), cells, strict=True)):
        try:
            found[k] = number(cell, Place(file, row, name))
        except Fault as fault:
            note(fault)
    return found


def are_epochs(cells: Sequence[str] | Array) -> bool:
    """Return whether the first cell that holds something is a date, and no number."""
    if isinstance(cells, np.ndarray):
        return False
    first = next((cell for cell in cells if cell.lower() not in MISSING), "")
    return len(first) > 8 and first[:4].isdigit() and first[4] == "-"


def with_clock(header: Header, time: int, place: Place) -> tuple[Header, str]:
    """Return a header whose times are in seconds, and the clock of its epochs; UTC where none is named."""
    clock = header.units[time] or "UTC"
    if clock not in TO_TT:
        place._replace(column=header.names[time]).refuse(
            f"a clock of epochs, {', '.join(TO_TT)}", repr(clock)
        )
    bare = all(unit is None for k, unit in enumerate(header.units) if k != time)
    units = [None if bare else "s" if k == time else unit for k, unit in enumerate(header.units)]
    return header._replace(units=tuple(units)), clock


def elapsed(sheet: Sheet, column: int, clock: str, note: Note) -> tuple[Array, int]:
    """Return the seconds from the first of the epochs in a column, NaN where there is none, and that epoch.

    A blank in place of the T is taken, and an offset of zero behind the time.
    """
    name, file = sheet.header.names[column], sheet.place.file
    moments: list[int | None] = []
    for row, cell in zip(sheet.rows.tolist(), sheet.columns[column], strict=True):
        text = str(cell).removesuffix("+00:00").replace(" ", "T", 1)
        try:
            moments.append(None if text.lower() in MISSING else epochs.instant(text, utc=clock == "UTC"))
        except ValueError as error:
            note(Fault(Place(file, row, name), str(error), repr(cell)))
            moments.append(None)
    start = min((moment for moment in moments if moment is not None), default=0)
    times = [math.nan if moment is None else (moment - start) / epochs.SECOND for moment in moments]
    return np.array(times), start
