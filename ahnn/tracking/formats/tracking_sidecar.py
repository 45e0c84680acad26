"""YAML sidecar with metadata that a tracking file lacks: `W3B.yaml` for `W3B.aer`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal, NamedTuple

import yaml

from ahnn.arguments import nearest
from ahnn.contents import plain_yaml
from ahnn.data.files import sidecar
from ahnn.data.files.raw import content_of, decoded
from ahnn.data.files.table import Place
from ahnn.tracking.formats.instants import CLOCKS
from ahnn.tracking.tracking_data import Event, Kind

TwoWay = Literal["half", "whole"]
"""Part of the round trip that a two-way range measures."""
COLUMNS: dict[str, tuple[Kind, ...]] = {
    "RANGE": ("range",),
    "RANGE_RATE": ("range_rate",),
    "AZ_EL": ("azimuth", "elevation"),
    "RA_DEC": ("right_ascension", "declination"),
}
ANGLES = {"deg": math.pi / 180, "rad": 1.0}
UNITS: dict[Kind, dict[str, float]] = {
    "range": {"km": 1.0, "m": 1e-3},
    "range_rate": {"km/s": 1.0, "m/s": 1e-3},
    **dict.fromkeys((*COLUMNS["AZ_EL"], *COLUMNS["RA_DEC"]), ANGLES),
}
"""Units of each kind, with factors to km, km/s and rad; the first is the default."""
NAMES: dict[str, tuple[Kind, ...]] = {**COLUMNS, **{kind: (kind,) for kind in UNITS}}
"""Kinds of measurement for each key of `units` and `deviations`: `AZ_EL`, or `azimuth` alone."""
EVENTS = ("receive", "transmit", "bounce")
KEYS = ("object", "clock", "event", "units", "deviations", "two_way")


class TrackingSidecar(NamedTuple):
    """Content of the sidecar of a tracking file.

    Attributes:
        object: name of the satellite.
        clock: time scale of the epochs.
        event: event tagged by the epochs.
        units: unit of each kind.
        deviations: standard deviations of each kind, in its unit.
        two_way: part of the round trip that two-way ranges and rates measure, half or whole.
        given: whether a sidecar exists.
    """

    object: str = ""
    clock: str = "UTC"
    event: Event = "receive"
    units: dict[Kind, str] = {}  # noqa: RUF012 - never written to
    deviations: dict[Kind, float] = {}  # noqa: RUF012 - never written to
    two_way: TwoWay = "half"
    given: bool = True


def sidecar_of(path: Path, aside: Path | None = None) -> TrackingSidecar:
    """Read the sidecar of a file, by default the YAML file of the same name.

    Raises:
        UserError: an invalid sidecar, or a given path without a file.
    """
    beside = sidecar.beside(path) if aside is None else aside
    if aside is None and (beside == path or not beside.is_file()):
        return TrackingSidecar(given=False)
    return parse_sidecar(decoded(content_of(beside), beside), str(beside))


def parse_sidecar(text: str, file: str) -> TrackingSidecar:
    """Parse the sidecar of a tracking file.

    Raises:
        UserError: not YAML, an unknown key, or an invalid value.
    """
    place = Place(file)
    try:
        content = plain_yaml(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        place.refuse("YAML", " ".join(str(error).split()))
    given: dict[Any, Any] = content if isinstance(content, dict) else {str(content): None}
    for key in given:
        if key not in KEYS:
            expected = f"one of the keys {', '.join(KEYS)}"
            place.refuse(expected, f"{key!r}{nearest(str(key), KEYS)}", sidecar.OTHERWISE)
    said = TrackingSidecar(
        object=str(given.get("object", "")),
        clock=chosen(given.get("clock", "UTC"), CLOCKS, place._replace(column="clock")),
        event=chosen(given.get("event", "receive"), EVENTS, place._replace(column="event")),
        units=mapping(given.get("units", {}), place._replace(column="units")),
        two_way=chosen(given.get("two_way", "half"), ("half", "whole"), place._replace(column="two_way")),
        deviations=mapping(given.get("deviations", {}), place._replace(column="deviations")),
    )
    for kind, unit in said.units.items():
        chosen(unit, tuple(UNITS[kind]), place._replace(column=f"units: {kind}"))
    for kind, sigma in said.deviations.items():
        if isinstance(sigma, bool) or not isinstance(sigma, int | float) or not 0 < sigma < math.inf:
            place._replace(column=f"deviations: {kind}").refuse("a number above 0", repr(sigma))
    return said


def chosen(value: Any, among: tuple[str, ...], place: Place) -> Any:
    """Return a value if it is allowed; raises UserError otherwise."""
    return value if value in among else place.refuse(f"one of {', '.join(among)}", repr(value))


def mapping(value: Any, place: Place) -> dict[Kind, Any]:
    """Return the value for each kind; raises UserError for anything but different keys among `NAMES`."""
    given = value if isinstance(value, dict) else {str(value): None}
    kinds = [kind for key in given for kind in NAMES.get(key, (key,))]
    if len({*kinds}) < len(kinds) or not {*kinds} <= {*UNITS}:
        place.refuse(f"values for different kinds among {', '.join(NAMES)}", repr(value))
    return {kind: given[key] for key in given for kind in NAMES[key]}
