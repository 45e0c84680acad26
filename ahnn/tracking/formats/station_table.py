"""Plain tables of tracking data: each line has an epoch, a kind, a station and values.

    2010-11-02T03:00:13.3851   RANGE       Uralla         38014.9488
    2010-11-02T03:00:50.5716   AZ_EL       Kumsan           211.1446   43.4099

A table does not contain units. A sidecar (`tracking_sidecar`), a YAML file of the same name, gives them:

    object: W3B
    clock: UTC
    event: receive
    two_way: half
    units: {RANGE: km, RANGE_RATE: km/s, AZ_EL: deg, RA_DEC: deg}
    deviations: {RANGE: 0.02, AZ_EL: 0.02}
"""

from __future__ import annotations

from ahnn.data.files.table import Fault, Note, Place, refuse
from ahnn.tracking.formats.gathered import TrackingReading, gathered, measured
from ahnn.tracking.formats.instants import utc_moment
from ahnn.tracking.formats.tracking_sidecar import COLUMNS, UNITS, TrackingSidecar
from ahnn.tracking.tracking_data import Kind, TrackingData


def table_data(text: str, file: str, said: TrackingSidecar, note: Note = refuse) -> list[TrackingData]:
    """Return the measurements of one satellite from a table.

    Args:
        text: text of the table; lines that begin with # are skipped.
        file: file name.
        said: content of the table's sidecar.
        note: callback for invalid lines, which are then skipped.

    Raises:
        UserError: no measurement, or a fault raised by `note`.
    """
    found, kinds = [], set[str]()
    for row, line in enumerate(text.split("\n"), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                found.append(reading_of(line.split(), Place(file, row), said))
                kinds.add(line.split()[1])
            except Fault as fault:
                note(fault)
    if not found:
        Place(file).refuse("a measurement: epoch, kind, station and numbers", "none")
    assumed = ", ".join(f"{kind} in {unit_of(COLUMNS[kind][0], said)}" for kind in sorted(kinds))
    remarks = () if said.given else (f"no sidecar: {assumed} and epochs of reception in UTC are assumed",)
    return [gathered(said.object, found, said.event, remarks)]


def reading_of(cells: list[str], place: Place, said: TrackingSidecar) -> TrackingReading:
    """Parse the measurement of a line; raises UserError."""
    kind = cells[1] if len(cells) > 1 else ""
    if kind not in COLUMNS:
        place.refuse(f"an epoch and one of {', '.join(COLUMNS)}", repr(" ".join(cells[:2])))
    columns = COLUMNS[kind]
    if len(cells) != 3 + len(columns):
        place.refuse(f"epoch, {kind}, station and {' and '.join(columns)}", f"{len(cells)} values")
    moment = utc_moment(cells[0], place._replace(column="epoch"), said.clock)
    halved = 0.5 if said.two_way == "whole" and kind.startswith("RANGE") else 1.0
    values, deviations = dict[Kind, float](), dict[Kind, float]()
    for column, cell in zip(columns, cells[3:], strict=True):
        factor = halved * UNITS[column][unit_of(column, said)]
        values[column] = measured(column, cell, factor, place._replace(column=column))
        if (sigma := said.deviations.get(column)) is not None:
            deviations[column] = factor * sigma
    return TrackingReading(moment, cells[2], values, place.row, deviations=deviations)


def unit_of(kind: Kind, said: TrackingSidecar) -> str:
    """Return the unit of a kind, by default the first of `UNITS`."""
    return said.units.get(kind, next(iter(UNITS[kind])))
