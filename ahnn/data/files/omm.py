"""Orbit mean-elements messages (CCSDS 502.0-B) of SGP4: XML, keyword = value notation, CSV and JSON.

CSV and JSON have the form in which catalogues publish element sets: one column or key per keyword.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from functools import partial
from typing import Any

from ahnn.data.files import epochs
from ahnn.data.files.ccsds_fields import ABOUT, FieldMessage, field_messages
from ahnn.data.files.content import Content
from ahnn.data.files.ephemeris import moment
from ahnn.data.files.sgp4_orbits import MeanOrbit, sgp4_content
from ahnn.data.files.table import Fault, Note, Place, Remark, read_csv, refuse, within

SAID = {
    "CENTER_NAME": ("EARTH",),
    "REF_FRAME": ("TEME", "TEMEOFDATE", "TEME OF DATE"),
    "TIME_SYSTEM": ("UTC",),
    "MEAN_ELEMENT_THEORY": ("SGP4", "SGP/SGP4", "SGP"),
    "EPHEMERIS_TYPE": ("0", "2"),
}
"""Values assumed by SGP4; all other values are rejected. CSV omits the first four."""
ELEMENTS: dict[str, tuple[float, float, str]] = {
    "MEAN_MOTION": (1e-3, 20.0, "rev/day"),
    "ECCENTRICITY": (0.0, 0.999999999, ""),
    "INCLINATION": (0.0, 180.0, "deg"),
    "RA_OF_ASC_NODE": (-360.0, 360.0, "deg"),
    "ARG_OF_PERICENTER": (-360.0, 360.0, "deg"),
    "MEAN_ANOMALY": (-360.0, 360.0, "deg"),
    "BSTAR": (-100.0, 100.0, "1/er"),
}
"""Required elements with their bounds and units."""
DERIVATIVES = {"MEAN_MOTION_DOT": "rev/day**2", "MEAN_MOTION_DDOT": "rev/day**3"}
UNUSED = (
    *("OBJECT_ID", "NORAD_CAT_ID", "CLASSIFICATION_TYPE", "ELEMENT_SET_NO", "REV_AT_EPOCH", *DERIVATIVES),
    *("REF_FRAME_EPOCH", "MASS", "SOLAR_RAD_AREA", "SOLAR_RAD_COEFF", "DRAG_AREA", "DRAG_COEFF", "GM"),
)
"""Fields not needed by SGP4."""
OTHERS = ("SEMI_MAJOR_AXIS", "BTERM", "AGOM")
"""Fields of other theories."""
PUBLISHED = (
    *(
        "CCSDS_OMM_VERS",
        "COMMENT",
        "TLE_LINE0",
        "TLE_LINE1",
        "TLE_LINE2",
        "GP_ID",
        "FILE",
        "DECAY_DATE",
        "PERIOD",
    ),
    *("OBJECT_TYPE", "RCS_SIZE", "COUNTRY_CODE", "LAUNCH_DATE", "SITE", "DECAYED", "APOAPSIS", "PERIAPSIS"),
)
"""Fields added by catalogues, which are not used."""
NOT_USED = "not used: classes, mean motion derivatives, set and revolution numbers"
TO_2000 = 18263.0
"""Days from 1949-12-31, the SGP4 origin, to 2000-01-01."""
RANGE = epochs.instant("1957-01-01", utc=True), epochs.instant("2100-01-01", utc=True)


def omm_content(
    text: str,
    file: str,
    step: float | None,
    duration: float | None,
    *,
    note: Note = refuse,
) -> Content:
    """Return an SGP4 trajectory for each message, starting at its epoch.

    Args:
        text: messages in one of the four notations.
        file: file name.
        step: seconds between samples.
        duration: duration of each trajectory in seconds.
        note: callback for messages that are damaged or cannot be propagated, which are then skipped.

    Raises:
        UserError: no step or duration, no message, or an error raised by `note`.
    """
    read = partial(_orbits, text, file)
    names = {"named": "mean elements (OMM)", "expected": ABOUT["OMM"], "unused": NOT_USED}
    return sgp4_content(read, file, (step, duration), note=note, **names)


def _orbits(text: str, file: str, model: Any, note: Note) -> Iterator[MeanOrbit]:
    """Yield the orbit of each message; damaged ones are reported to `note` and skipped."""
    for one in omm_messages(text, file, note):
        try:
            yield _orbit(one, model, note)
        except Fault as fault:
            note(fault)


def omm_messages(text: str, file: str, note: Note = refuse) -> list[FieldMessage]:
    """Parse the messages of a text; raises UserError for an unknown notation."""
    begin = text.lstrip()[:1]
    if begin in ("[", "{"):
        return list(_of_json(text, file, note))
    if begin == "<" or text.lstrip().startswith(("CCSDS_OMM", "COMMENT")):
        return field_messages(text, file, "OMM")
    return list(_of_csv(text, file, note))


def _of_json(text: str, file: str, note: Note) -> Iterator[FieldMessage]:
    """Yield the messages of JSON: an object or a list of them, numbered from 1."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        Place(file).refuse("JSON", " ".join(str(error).split()))
    for row, one in enumerate(content if isinstance(content, list) else [content], 1):
        message = FieldMessage(Place(file, row), ABOUT["OMM"])
        if not isinstance(one, dict) or not all(
            isinstance(v, str | int | float | None) for v in one.values()
        ):
            note(Fault(message.place, "an object with a text or number for each keyword", repr(one)[:60]))
            continue
        for key, value in one.items():
            if value is not None:
                message.add(str(key), str(value), None, message.place)
        yield message


def _of_csv(text: str, file: str, note: Note) -> Iterator[FieldMessage]:
    """Yield the messages of a table, one per row."""
    sheet = read_csv(text, file, note)
    for k, row in enumerate(sheet.rows):
        message = FieldMessage(Place(file, int(row)), ABOUT["OMM"])
        for key, cells in zip(sheet.header.names, sheet.columns, strict=True):
            if str(cells[k]):
                message.add(key, str(cells[k]), None, message.place)
        yield message


def _orbit(one: FieldMessage, model: Any, note: Note) -> MeanOrbit:
    """Return the orbit of a message; raises Fault for values not accepted by SGP4."""
    for key, words in SAID.items():
        if key in one.values and one.values[key].upper() not in words:
            one.at(key).refuse(" or ".join(words[:2]), repr(one.values[key]))
    for key in OTHERS:
        if key in one.values:
            one.at(key).refuse("SGP4 mean elements", f"{key}, which belongs to another theory")
    one.require_units(_unit_of)
    values = {key: within(one.text(key), one.at(key), low, high) for key, (low, high, _) in ELEMENTS.items()}
    for key in DERIVATIVES:
        if key in one.values:
            within(one.values[key], one.at(key), -100.0, 100.0)
    start = moment(one.text("EPOCH"), one.at("EPOCH"), utc=True)
    if not RANGE[0] <= start < RANGE[1]:
        one.at("EPOCH").refuse("an epoch from 1957 to 2100", repr(one.values["EPOCH"]))
    known = (*SAID, *ELEMENTS, *UNUSED, "EPOCH", "OBJECT_NAME", *PUBLISHED)
    if other := [name for name in one.unknown(known) if not name.startswith(("C", "COV_"))]:
        note(Remark(one.place, f"not OMM keywords, ignored: {', '.join(other)}", "", "warning"))
    title = one.values.get("OBJECT_NAME", "")
    name = one.values.get("NORAD_CAT_ID") or title or one.text("OBJECT_ID")
    satellite, designator = _satellite(values, start, model), one.values.get("OBJECT_ID", "")
    return MeanOrbit(one.place, name, satellite, start, title, designator)


def _unit_of(key: str) -> str:
    """Return the standard unit of a keyword."""
    return ELEMENTS[key][2] if key in ELEMENTS else DERIVATIVES.get(key, "")


def _satellite(values: dict[str, float], start: int, model: Any) -> Any:
    """Return the SGP4 satellite of elements, in rad and rad/min, with the epoch in days since 1949-12-31."""
    days, of_day = epochs.day_and_time(start, utc=True)
    day = TO_2000 + days + of_day / epochs.SECOND / epochs.DAY
    satellite = model.Satrec()
    angles = ("ARG_OF_PERICENTER", "INCLINATION", "MEAN_ANOMALY")
    perigee, inclination, anomaly = (math.radians(values[key]) for key in angles)
    motion, node = values["MEAN_MOTION"] * math.pi / 720, math.radians(values["RA_OF_ASC_NODE"])
    numbers = (values["BSTAR"], 0.0, 0.0, values["ECCENTRICITY"], perigee, inclination, anomaly, motion, node)
    satellite.sgp4init(model.WGS72, "i", 0, day, *numbers)
    return satellite
