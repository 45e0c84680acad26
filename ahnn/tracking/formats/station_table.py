"""A plain table of what stations measured: on each line an epoch, a kind, a station and numbers.

    2010-11-02T03:00:13.3851   RANGE       Uralla         38014.9488
    2010-11-02T03:00:50.5716   AZ_EL       Kumsan           211.1446   43.4099

A table does not say its units. A sidecar does, a YAML of the same name, such as `W3B.yaml` beside `W3B.aer`:

    object: W3B
    clock: UTC
    event: receive
    units: {RANGE: km, RANGE_RATE: km/s, AZ_EL: deg, RA_DEC: deg}
    deviations: {RANGE: 0.02, AZ_EL: 0.02}
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from ahnn.arguments import nearest
from ahnn.contents import plain_yaml
from ahnn.data.files import sidecar
from ahnn.data.files.raw import content_of, decoded
from ahnn.data.files.table import Fault, Note, Place, refuse, within
from ahnn.tracking.formats.gathered import BOUNDS, TrackingReading, gathered
from ahnn.tracking.formats.instants import CLOCKS, utc_moment
from ahnn.tracking.tracking_data import Event, Kind, TrackingData

LINE = re.compile(r"\s*\d{4}-\S+T\S+\s+(RANGE|RANGE_RATE|AZ_EL|RA_DEC)\s+\S+\s+[-+.\d]")
"""How a line of such a table begins."""
COLUMNS: dict[str, tuple[Kind, ...]] = {
    "RANGE": ("range",),
    "RANGE_RATE": ("range_rate",),
    "AZ_EL": ("azimuth", "elevation"),
    "RA_DEC": ("right_ascension", "declination"),
}
UNITS = {
    "RANGE": {"km": 1.0, "m": 1e-3},
    "RANGE_RATE": {"km/s": 1.0, "m/s": 1e-3},
    "AZ_EL": {"deg": math.pi / 180, "rad": 1.0},
    "RA_DEC": {"deg": math.pi / 180, "rad": 1.0},
}
"""Of each kind, and the factors to km, km/s and rad; the first is taken where nobody says."""
EVENTS = ("receive", "transmit", "bounce")
KEYS = ("object", "clock", "event", "units", "deviations")


class TableSidecar(NamedTuple):
    """What a sidecar says of a table.

    Attributes:
        object: name of the satellite.
        clock: of the epochs.
        event: what they tag.
        units: of each kind.
        deviations: standard deviations of each kind, in its unit.
        given: whether there is a sidecar.
    """

    object: str = ""
    clock: str = "UTC"
    event: Event = "receive"
    units: dict[str, str] = {}  # noqa: RUF012 - never written to
    deviations: dict[str, float] = {}  # noqa: RUF012 - never written to
    given: bool = True


def read_station_table(path: str | Path, aside: str | Path | None = None) -> list[TrackingData]:
    """Return what a plain table of measurements holds.

    Args:
        path: of the table.
        aside: its sidecar; None is the YAML of its name, if there is one.

    Raises:
        UserError: names the line of what is wrong.
    """
    path = Path(path)
    beside = sidecar.beside(path) if aside is None else Path(aside)
    said = TableSidecar(given=False)
    if aside is not None or (beside != path and beside.is_file()):
        said = parse_sidecar(decoded(content_of(beside), beside), str(beside))
    return table_data(decoded(content_of(path), path), str(path), said)


def table_data(text: str, file: str, said: TableSidecar, note: Note = refuse) -> list[TrackingData]:
    """Return the measurements of a table, of one satellite.

    Args:
        text: of the table; lines that begin with # are left out.
        file: its name.
        said: what its sidecar says.
        note: of a line that is no measurement, which is then left out.

    Raises:
        UserError: no measurement, or what `note` raises.
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
    assumed = ", ".join(f"{kind} in {unit_of(kind, said)[0]}" for kind in sorted(kinds))
    remarks = () if said.given else (f"no sidecar: taken for {assumed}, epochs of reception in UTC",)
    return [gathered(said.object, found, said.event, remarks)]


def reading_of(cells: list[str], place: Place, said: TableSidecar) -> TrackingReading:
    """Return the measurement of a line; raises UserError."""
    kind = cells[1] if len(cells) > 1 else ""
    if kind not in COLUMNS:
        place.refuse(f"an epoch and one of {', '.join(COLUMNS)}", repr(" ".join(cells[:2])))
    columns = COLUMNS[kind]
    if len(cells) != 3 + len(columns):
        place.refuse(f"epoch, {kind}, station and {' and '.join(columns)}", f"{len(cells)} values")
    moment = utc_moment(cells[0], place._replace(column="epoch"), said.clock)
    factor, values = unit_of(kind, said)[1], dict[Kind, float]()
    for column, cell in zip(columns, cells[3:], strict=True):
        low, high = (bound / factor for bound in BOUNDS[column])
        values[column] = factor * within(cell, place._replace(column=column), low, high)
    sigma = said.deviations.get(kind)
    deviations = {} if sigma is None else dict.fromkeys(columns, factor * sigma)
    return TrackingReading(moment, cells[2], values, place.row, deviations=deviations)


def unit_of(kind: str, said: TableSidecar) -> tuple[str, float]:
    """Return the unit of a kind and its factor."""
    name = said.units.get(kind, next(iter(UNITS[kind])))
    return name, UNITS[kind][name]


def parse_sidecar(text: str, file: str) -> TableSidecar:
    """Return what a sidecar says of a table.

    Raises:
        UserError: no YAML, another key, or a value that is none of its key.
    """
    place = Place(file)
    try:
        content = plain_yaml(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        place.refuse("YAML", " ".join(str(error).split()))
    given: dict[Any, Any] = content if isinstance(content, dict) else {str(content): None}
    for key in given:
        if key not in KEYS:
            place.refuse(
                f"keys {', '.join(KEYS)} of a table of measurements", f"{key!r}{nearest(str(key), KEYS)}"
            )
    said = TableSidecar(
        object=str(given.get("object", "")),
        clock=chosen(given.get("clock", "UTC"), CLOCKS, place._replace(column="clock")),
        event=chosen(given.get("event", "receive"), EVENTS, place._replace(column="event")),
        units=mapping(given.get("units", {}), place._replace(column="units")),
        deviations=mapping(given.get("deviations", {}), place._replace(column="deviations")),
    )
    for kind, unit in said.units.items():
        chosen(unit, tuple(UNITS[kind]), place._replace(column=f"units: {kind}"))
    for kind, sigma in said.deviations.items():
        if isinstance(sigma, bool) or not isinstance(sigma, int | float) or not 0 < sigma < math.inf:
            place._replace(column=f"deviations: {kind}").refuse("a number above 0", repr(sigma))
    return said


def chosen(value: Any, among: tuple[str, ...], place: Place) -> Any:
    """Return one of several words; raises UserError for another."""
    return value if value in among else place.refuse(f"one of {', '.join(among)}", repr(value))


def mapping(value: Any, place: Place) -> dict[str, Any]:
    """Return values of kinds; raises UserError for what is none."""
    if not isinstance(value, dict) or any(key not in COLUMNS for key in value):
        place.refuse(f"values of {', '.join(COLUMNS)}", repr(value))
    return value
