"""Tables of samples, one a row, as the content of a file."""

from __future__ import annotations

import numpy as np

from ahnn.data.files.columns import Roles, roles
from ahnn.data.files.content import Content
from ahnn.data.files.samples import Track, by_id, require_order
from ahnn.data.files.scales import scales
from ahnn.data.files.sidecar import Sidecar, with_units
from ahnn.data.files.table import Lines, Place, number, read_csv


def from_csv(text: str, file: str, sidecar: Sidecar, *, weighed: bool) -> Content:
    """Return the content of separated values.

    Args:
        text: of the file.
        file: its name, for messages.
        sidecar: what stands beside it.
        weighed: whether a mass is stated.

    Raises:
        UserError: names row and column of what is wrong.
    """
    lines = read_csv(text, file)
    place = lines.place
    header = with_units(lines.header, sidecar, place)
    found = roles(header, sidecar.columns, place)
    if not lines.rows:
        place.refuse("a row for each sample", "a header alone")
    by = scales(header, found, place, weighed=weighed)
    whole = numbers(lines, found, file)
    whole = whole._replace(times=whole.times * by.time, values=whole.values * (*by.positions, *by.rates))
    ids = [""] * len(lines.rows) if found.id is None else [cells[found.id] for _, cells in lines.rows]
    tracks = by_id(ids, whole)
    for track in tracks:
        require_order(track, header.names[found.time])
    positions, rates = (tuple(header.names[i] for i in columns) for columns in (found.positions, found.rates))
    return Content(positions, rates, found.kind == "momenta", by.units, sidecar.frame, tuple(tracks))


def numbers(lines: Lines, found: Roles, file: str) -> Track:
    """Return the samples of all rows in the units of the file; raises UserError for what is no number."""
    columns = (found.time, *found.positions, *found.rates)
    names = [(i, lines.header.names[i]) for i in columns]
    values = np.array(
        [[number(cells[i], Place(file, row, name)) for i, name in names] for row, cells in lines.rows]
    )
    rows = np.array([row for row, _ in lines.rows], dtype=np.int64)
    return Track("", file, rows, values[:, 0], values[:, 1:])
