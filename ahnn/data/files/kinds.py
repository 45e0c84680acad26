"""Detection of file formats by content; the file extension decides only if the content is ambiguous."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal, NoReturn

from ahnn.data.files.raw import content_of
from ahnn.data.files.table import Place
from ahnn.errors import UserError

Kind = Literal[
    "table",
    "parquet",
    "oem",
    "xml",
    "elements",
    "opm",
    "omm",
    "sp3",
    "cpf",
    "tdm",
    "crd",
    "station_table",
    "sinex",
    "bulletin_b",
]
ABOUT: dict[Kind, str] = {
    "table": "a table",
    "parquet": "Parquet",
    "oem": "an orbit ephemeris message (OEM)",
    "xml": "an orbit ephemeris message (OEM)",
    "elements": "two-line element sets",
    "opm": "an orbit parameter message (OPM)",
    "omm": "mean elements (OMM)",
    "sp3": "precise ephemerides (SP3)",
    "cpf": "laser ranging predictions (CPF)",
    "tdm": "a tracking data message (TDM)",
    "crd": "laser ranging data (CRD)",
    "station_table": "a table of station measurements",
    "sinex": "station coordinates (SINEX)",
    "bulletin_b": "an IERS Bulletin B",
}
"""Descriptions of file kinds."""
TABLES: tuple[Kind, ...] = ("table", "parquet")
TRACKING: tuple[Kind, ...] = ("tdm", "crd", "station_table", "sinex", "bulletin_b")
"""Kinds without trajectories, which `ahnn.tracking` reads."""
READ = ", ".join(about for kind, about in ABOUT.items() if kind not in (*TRACKING, "xml"))
SUFFIXES: dict[str, Kind] = {
    ".parquet": "parquet",
    ".oem": "oem",
    ".xml": "xml",
    ".tle": "elements",
}
"""Extensions that decide the kind of files with ambiguous content, i.e. damaged ones."""
ELEMENTS = re.compile(r"1 [ \dA-Z]{5}[A-Z ] ")
MESSAGE = re.compile(r"CCSDS_(\w+)_VERS\b")
ROOT = re.compile(r"<(?:\w+:)?(oem|opm|omm|tdm)\b")
IN_XML: dict[str, Kind] = {"oem": "xml", "opm": "opm", "omm": "omm", "tdm": "tdm"}
IN_WORDS: dict[str, Kind] = {"OEM": "oem", "OPM": "opm", "OMM": "omm", "TDM": "tdm"}
"""Supported CCSDS messages, by XML element and by name."""
MEAN_ELEMENTS = re.compile(r"(?=.*\bMEAN_MOTION\b).*\bECCENTRICITY\b", re.DOTALL)
MESSAGES = {
    "OPM": "an orbit parameter message (OPM) with one state",
    "OMM": "an orbit mean-elements message (OMM)",
    "OCM": "an orbit comprehensive message (OCM)",
    "TDM": "a tracking data message (TDM)",
    "AEM": "an attitude ephemeris message (AEM)",
    "APM": "an attitude parameter message (APM)",
    "ACM": "an attitude comprehensive message (ACM)",
    "CDM": "a conjunction data message (CDM)",
    "RDM": "a re-entry data message (RDM)",
}
"""CCSDS messages that are not ephemerides."""
REMEDIES = {"OCM": "Write its trajectory as an OEM"}
BINARY = {
    b"PK\x03\x04": "a zip archive, such as .xlsx or .npz",
    b"\xd0\xcf\x11\xe0": "an old Excel file",
    b"\x93NUMPY": "a NumPy array",
    b"\x1f\x8b": "a gzip archive",
    b"\x89HDF": "an HDF5 file",
    b"CDF": "a NetCDF file",
    b"DAF/": "a SPICE kernel",
    b"SQLite format 3": "an SQLite database",
    b"ARROW1": "a Feather file",
    b"%PDF": "a PDF",
}
SIGNS: tuple[tuple[re.Pattern[str], Kind], ...] = (
    (re.compile(r"#[a-d][PV]\s*\d{4}\s"), "sp3"),
    (re.compile(r"%=SNX\b"), "sinex"),
    (MEAN_ELEMENTS, "omm"),
)
"""Beginnings of the first line of supported formats."""
SIGHTING_COLUMNS = re.compile(
    r"(?i)(?=.*[,;\t])(?=.*\b(station|sensor)\b)(?=.*\b(range|elevation|declination)(_|\b))"
)
"""Header of a table of station measurements."""
SIGHTINGS_ALONE = re.compile(
    r"(?i)(?=.*\brange(_|\b))(?=.*\b(azimuth|elevation)(_|\b))(?!.*\b(station|sensor)\b)"
)
"""Header of such a table without the names of the stations."""
NO_STATION = "a column station with the name of the station, as in each table of ranges and angles"
LINES: tuple[tuple[re.Pattern[str], Kind], ...] = (
    (re.compile(r"\s*H1\s+CPF\b", re.IGNORECASE), "cpf"),
    (re.compile(r"\s*H1\s+CRD\b", re.IGNORECASE), "crd"),
    (re.compile(r"\s*\d{4}-\S+T\S+\s+(RANGE|RANGE_RATE|AZ_EL|RA_DEC)\s+\S+\s+[-+.\d]"), "station_table"),
    (SIGHTING_COLUMNS, "station_table"),
    (re.compile(r"\s*BULLETIN B \d+", re.IGNORECASE), "bulletin_b"),
)
"""Beginnings of the first lines that are not comments."""
TEXTS = (
    (re.compile(r".{60}(RINEX|CRINEX) VERS"), "RINEX"),
    (re.compile(r".{60}(IONEX|ANTEX) VERS"), "IONEX or ANTEX"),
    (re.compile(r"%=(TRO|BIA)"), "SINEX for the troposphere or for biases"),
    (re.compile(r"stk\.v\.", re.IGNORECASE), "an STK file"),
    (re.compile(r"[\[{]"), "JSON"),
    (re.compile(r"\*{20,}"), "JPL Horizons output"),
    (re.compile(r"(product_type|begin_of_head)\b"), "a gravity field (GFC)"),
    (re.compile(r"\s*\d{4} [A-Z]{3} +\d+ =JD"), "leap seconds (tai-utc.dat), which ahnn already knows"),
)
"""Beginnings of the first line of unsupported formats."""


def kind_of(raw: bytes, file: str) -> Kind:
    """Detect the kind of a file.

    Args:
        raw: content of the file.
        file: file name.

    Raises:
        UserError: unsupported format, named in the message.
    """
    suffix = "." + file.rpartition(".")[2].lower()
    if raw.startswith(b"PAR1"):
        return "parquet"
    for sign, name in BINARY.items():
        if raw.startswith(sign):
            refuse(file, name)
    head = [line for line in raw[:4096].decode("utf-8-sig", "replace").splitlines() if line.strip()]
    first = head[0].lstrip() if head else ""
    if first.startswith("<"):
        found = ROOT.search("\n".join(head))
        return IN_XML[found[1]] if found else "xml"
    if found := MESSAGE.match(first):
        return IN_WORDS[found[1]] if found[1] in IN_WORDS else refuse_message(found[1], Place(file))
    if first[:1] in ("[", "{") and MEAN_ELEMENTS.search("\n".join(head)):
        return "omm"
    plain = [line for line in head if not line.startswith("#")]
    if any(ELEMENTS.match(line) for line in plain[:2]):
        return "elements"
    for signs, lines in ((SIGNS, head[:1]), (LINES, plain[:5])):
        for pattern, kind in signs:
            if any(pattern.match(line) or pattern.match(line.lstrip()) for line in lines):
                return kind
    for pattern, name in TEXTS if head else ():
        if pattern.match(first) or pattern.match(head[0]):
            refuse(file, name)
    return SUFFIXES.get(suffix, "table")


def holds_mean_elements(path: Path) -> bool:
    """Return whether a file contains mean elements (OMM), recognised in JSON by their keys only."""
    try:
        return kind_of(content_of(path), str(path)) == "omm"
    except UserError:
        return False


def refuse(file: str, received: str) -> NoReturn:
    """Raise Fault for a file of an unsupported format."""
    Place(file).refuse(READ, received, "Write its samples as a table (docs/data.md)")


def refuse_message(name: str, place: Place) -> NoReturn:
    """Raise Fault for a CCSDS message that is not an ephemeris."""
    received = MESSAGES.get(name, f"a CCSDS message {name}")
    place.refuse("an orbit ephemeris message (OEM)", received, REMEDIES.get(name, ""))
