"""Writing of tracking data messages (CCSDS 503.0-B), in keyword = value notation or in XML."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from ahnn.data.files import epochs
from ahnn.errors import UserError
from ahnn.files import write_atomically
from ahnn.tracking.formats.tdm_segment import VERSION
from ahnn.tracking.tracking_data import KINDS, Kind, TrackingData

KEYWORDS: tuple[tuple[str, dict[Kind, str]], ...] = (
    ("AZEL", {"azimuth": "ANGLE_1", "elevation": "ANGLE_2"}),
    ("RADEC", {"right_ascension": "ANGLE_1", "declination": "ANGLE_2"}),
)
"""Angle types with keywords; a segment has one type."""
OTHERS: dict[Kind, str] = {"range": "RANGE", "range_rate": "DOPPLER_INSTANTANEOUS"}
WEATHER = (("PRESSURE", 1.0), ("TEMPERATURE", 1.0), ("RHUMIDITY", 100.0))
"""Weather keywords by column, and unit conversion factors."""

Record = tuple[str, str, str]
"""Keyword, epoch and value."""


def write_tdm(
    path: str | Path,
    data: Iterable[TrackingData],
    originator: str = "ahnn",
    frame: str = "EME2000",
) -> None:
    """Write a message atomically.

    Ranges and rates refer to half of the two-way path. The format has no fields for wavelengths and standard
    deviations, which are not written.

    Args:
        path: path of the file, in XML if it ends in .xml, otherwise in keyword = value notation.
        data: tracking data of one or several satellites.
        originator: originator of the message.
        frame: reference frame of right ascension and declination.

    Raises:
        UserError: times of reflection, which the format does not support.
    """
    segments = [segment for one in data for segment in segments_of(one, frame)]
    written = _xml if Path(path).suffix.lower() == ".xml" else _kvn
    write_atomically(Path(path), written(segments, originator).encode())


def segments_of(data: TrackingData, frame: str) -> Iterator[tuple[dict[str, str], list[Record]]]:
    """Yield metadata and data of each station and angle type; raises UserError for times of reflection."""
    if data.event == "bounce":
        message = "write_tdm: expected times of reception or transmission; received times of reflection"
        raise UserError(message)
    for k, station in enumerate(data.stations):
        rows = np.flatnonzero(data.station == k)
        for number, (angles, keywords) in enumerate(KEYWORDS):
            names: dict[Kind, str] = keywords if number else {**OTHERS, **keywords}
            records = list(_records(data, rows, names))
            if not records:
                continue
            if not number:
                records += _weather(data, rows)
            yield _metadata(data, station, angles, frame), records


def _metadata(data: TrackingData, station: str, angles: str, frame: str) -> dict[str, str]:
    """Return the metadata of a segment."""
    return {
        "TIME_SYSTEM": "UTC",
        "PARTICIPANT_1": station,
        "PARTICIPANT_2": data.object or "UNKNOWN",
        "MODE": "SEQUENTIAL",
        "PATH": "1,2,1",
        "TIMETAG_REF": {"receive": "RECEIVE", "transmit": "TRANSMIT"}[data.event],
        "RANGE_MODULUS": "0",
        "RANGE_UNITS": "km",
        "ANGLE_TYPE": angles,
        **({"REFERENCE_FRAME": frame} if angles == "RADEC" else {}),
    }


def _records(data: TrackingData, rows: np.ndarray, names: dict[Kind, str]) -> Iterator[Record]:
    """Yield the measurements of some kinds in order of time, angles in degrees."""
    for row in rows:
        for kind, keyword in names.items():
            value = float(data.values[row, KINDS.index(kind)])
            if math.isfinite(value):
                yield (
                    keyword,
                    _epoch(data, row),
                    f"{math.degrees(value) if 'ANGLE' in keyword else value:.16g}",
                )


def _weather(data: TrackingData, rows: np.ndarray) -> list[Record]:
    """Return the weather at the times of the measurements, each time once."""
    found = {
        (keyword, _epoch(data, row)): f"{factor * data.weather[row, c]:.16g}"
        for c, (keyword, factor) in enumerate(WEATHER)
        for row in rows
        if math.isfinite(data.weather[row, c])
    }
    return [(keyword, epoch, value) for (keyword, epoch), value in found.items()]


def _epoch(data: TrackingData, row: int) -> str:
    return epochs.spelled(data.epoch + round(float(data.times[row]) * epochs.SECOND), utc=True)


def _kvn(segments: list[tuple[dict[str, str], list[Record]]], originator: str) -> str:
    """Format a message of version 2.0 in keyword = value notation."""
    lines = [f"{VERSION} = 2.0", f"CREATION_DATE = {epochs.now()}", f"ORIGINATOR = {originator}"]
    for meta, records in segments:
        said = [f"{key} = {value}" for key, value in meta.items()]
        seen = [f"{keyword} = {epoch} {value}" for keyword, epoch, value in records]
        lines += ["", "META_START", *said, "META_STOP", "", "DATA_START", *seen, "DATA_STOP"]
    return "\n".join(lines) + "\n"


def _xml(segments: list[tuple[dict[str, str], list[Record]]], originator: str) -> str:
    """Format a message of version 2.0 in XML."""
    message = Element("tdm", {"id": VERSION, "version": "2.0"})
    head = SubElement(message, "header")
    SubElement(head, "CREATION_DATE").text = epochs.now()
    SubElement(head, "ORIGINATOR").text = originator
    body = SubElement(message, "body")
    for meta, records in segments:
        segment = SubElement(body, "segment")
        said, seen = SubElement(segment, "metadata"), SubElement(segment, "data")
        for key, value in meta.items():
            SubElement(said, key).text = value
        for keyword, epoch, value in records:
            one = SubElement(seen, "observation")
            SubElement(one, "EPOCH").text = epoch
            SubElement(one, keyword).text = value
    indent(message)
    return tostring(message, encoding="unicode", xml_declaration=True) + "\n"
