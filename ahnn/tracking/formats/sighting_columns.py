"""Tables of tracking data in columns: each line has a time, a station and its measurements at that time.

    time,station,range_km,azimuth_deg,elevation_deg
    2010-11-02T03:00:13.3851,Uralla,38014.9488,211.1446,43.4099

Units follow the names, as in `range [km]`, or are given in the sidecar of `station_table`, which also names
the event tagged by the times. Columns such as `sd_range` contain standard deviations; the column `object`
contains names of satellites.
"""

from __future__ import annotations

from typing import NamedTuple

from ahnn.arguments import nearest
from ahnn.data.files import units
from ahnn.data.files.kinds import NO_STATION, SIGHTING_COLUMNS, SIGHTINGS_ALONE
from ahnn.data.files.table import MISSING, Fault, Note, Place, column_of, read_csv, refuse, within
from ahnn.tracking.formats.gathered import TrackingReading, gathered, measured
from ahnn.tracking.formats.instants import CLOCKS, utc_moment
from ahnn.tracking.formats.tracking_sidecar import TrackingSidecar
from ahnn.tracking.tracking_data import KINDS, UNITS, Kind, TrackingData

TIMES, STATIONS, OBJECTS = ("time", "t", "epoch"), ("station", "sensor"), ("object", "satellite", "id")
SD = "sd_"
"""Prefix of the columns of standard deviations."""


class SightingColumns(NamedTuple):
    """Roles of the columns.

    Attributes:
        time, station: indices of these columns.
        clock: time scale of the epochs.
        object: index of the column of satellite names; None for one satellite.
        values, deviations: column index and factor to km, rad or km/s, by kind.
        stated: standard deviations from the sidecar, used where no column contains any.
    """

    time: int
    station: int
    clock: str
    object: int | None
    values: dict[Kind, tuple[int, float]]
    deviations: dict[Kind, tuple[int, float]]
    stated: dict[Kind, float]


def columns_data(text: str, file: str, said: TrackingSidecar, note: Note = refuse) -> list[TrackingData]:
    """Return the measurements of a table in columns, by satellite.

    Args:
        text: text of the table.
        file: file name.
        said: content of the table's sidecar.
        note: callback for invalid lines, which are then skipped.

    Raises:
        UserError: an unknown column or unit, no measurement, or a fault raised by `note`.
    """
    sheet = read_csv(text, file, note)
    roles = roles_of(sheet.header.names, sheet.header.units, sheet.place, said)
    found: dict[str, list[TrackingReading]] = {}
    for row, cells in zip(sheet.rows.tolist(), zip(*sheet.columns, strict=True), strict=True):
        try:
            reading = reading_of([str(cell) for cell in cells], Place(file, row), roles)
        except Fault as fault:
            note(fault)
        else:
            name = said.object if roles.object is None else str(cells[roles.object])
            found.setdefault(name, []).extend([reading] if reading.values else [])
    if not any(found.values()):
        Place(file).refuse("a measurement: time, station and numbers", "none")
    return [gathered(name, readings, said.event) for name, readings in found.items() if readings]


def has_columns(text: str) -> bool:
    """Return whether the first line of a table of measurements contains column names."""
    first = next(
        (line for line in text.split("\n") if line.strip() and not line.lstrip().startswith("#")), ""
    )
    return any(header.match(first) for header in (SIGHTING_COLUMNS, SIGHTINGS_ALONE))


def roles_of(
    names: tuple[str, ...], given: tuple[str | None, ...], place: Place, said: TrackingSidecar
) -> SightingColumns:
    """Determine the roles of columns from their names and units; raises UserError."""
    known = (*TIMES, *STATIONS, *OBJECTS, *KINDS, *(SD + kind for kind in KINDS))
    parts = [column_of(name, known) for name in names]
    cells = [name for name, _ in parts]
    for name, cell in zip(names, cells, strict=True):
        if cell not in known or cells.count(cell) > 1:
            received = f"{name!r}{nearest(name, known)}"
            place.refuse(
                f"different columns among {', '.join((*TIMES[:1], *STATIONS[:1], *KINDS))}", received
            )
    one = [[k for k, cell in enumerate(cells) if cell in role] for role in (TIMES, STATIONS, OBJECTS)]
    if not one[1]:
        place._replace(column="station").refuse(NO_STATION, ", ".join(names))
    if len(one[0]) != 1 or len(one[1]) != 1 or len(one[2]) > 1:
        place.refuse("one time column, one station column, and at most one object column", ", ".join(names))
    time, station = one[0][0], one[1][0]
    clock = given[time] or said.clock
    if clock not in CLOCKS:
        place._replace(column=names[time]).refuse(f"one of the time scales {', '.join(CLOCKS)}", repr(clock))
    values, deviations = dict[Kind, tuple[int, float]](), dict[Kind, tuple[int, float]]()
    for k, (cell, unit) in enumerate(parts):
        kind: Kind | None = next((one for one in KINDS if cell.removeprefix(SD) == one), None)
        if kind is not None:
            unit = unit or given[k] or said.units.get(kind)
            where = place._replace(column=cell)
            halved = 0.5 if said.two_way == "whole" and kind.startswith("range") else 1.0
            target = deviations if cell.startswith(SD) else values
            target[kind] = k, halved * factor_of(kind, unit, where)
    if not values:
        place.refuse(f"at least one of the columns {', '.join(KINDS)}", ", ".join(names))
    stated = dict[Kind, float]()
    for kind, (_, factor) in values.items():
        if (sd := said.deviations.get(kind)) is not None:
            stated[kind] = sd * factor
    return SightingColumns(time, station, clock, one[2][0] if one[2] else None, values, deviations, stated)


def factor_of(kind: Kind, unit: str | None, place: Place) -> float:
    """Return the factor from a unit to the unit of a kind; raises UserError."""
    if unit is None:
        example = "deg" if UNITS[kind] == "rad" else UNITS[kind]
        place.refuse(f"a unit, such as {kind} [{example}]", "none")
    try:
        return units.factor(unit, UNITS[kind])
    except ValueError:
        place.refuse(f"{kind} in {UNITS[kind]}, or in a compatible unit", repr(unit))


def reading_of(cells: list[str], place: Place, roles: SightingColumns) -> TrackingReading:
    """Parse the measurements of a line; missing ones are omitted. Raises UserError."""
    moment = utc_moment(cells[roles.time], place._replace(column="time"), roles.clock)
    if cells[roles.station].lower() in MISSING:
        place._replace(column="station").refuse("a station name", "none")
    values = dict[Kind, float]()
    for kind, (k, factor) in roles.values.items():
        if cells[k].lower() not in MISSING:
            values[kind] = measured(kind, cells[k], factor, place._replace(column=kind))
    deviations: dict[Kind, float] = {kind: sd for kind, sd in roles.stated.items() if kind in values}
    for kind, (k, factor) in roles.deviations.items():
        if cells[k].lower() not in MISSING:
            deviations[kind] = factor * within(cells[k], place._replace(column=SD + kind), 1e-30, 1e30)
    return TrackingReading(moment, cells[roles.station], values, place.row, deviations=deviations)
