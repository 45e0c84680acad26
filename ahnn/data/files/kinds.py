"""What a file is, told by its content: a name's ending decides only where the content says nothing."""

from __future__ import annotations

import re
from typing import Literal, NoReturn

from ahnn.data.files.table import Place

Kind = Literal["table", "parquet", "oem", "xml", "elements"]
READ = "a table, Parquet, an orbit ephemeris message (OEM) or two-line element sets"
SUFFIXES: dict[str, Kind] = {
    ".parquet": "parquet",
    ".oem": "oem",
    ".xml": "xml",
    ".tle": "elements",
}
"""Of files whose content says nothing: damaged ones."""
ELEMENTS = re.compile(r"1 [ \dA-Z]{5}[A-Z ] ")
MESSAGE = re.compile(r"CCSDS_(\w+)_VERS\b")
MESSAGES = {
    "OPM": "an orbit parameter message (OPM), one state",
    "OMM": "an orbit mean-elements message (OMM)",
    "OCM": "an orbit comprehensive message (OCM)",
    "TDM": "a tracking data message (TDM)",
    "AEM": "an attitude ephemeris message (AEM)",
    "APM": "an attitude parameter message (APM)",
    "ACM": "an attitude comprehensive message (ACM)",
    "CDM": "a conjunction data message (CDM)",
    "RDM": "a re-entry data message (RDM)",
}
"""Of CCSDS, that are not read."""
REMEDIES = {
    "OPM": "A start takes its numbers: start=[x, y, ...]",
    "OMM": "Get the same elements as two lines (TLE)",
    "OCM": "Write its trajectory as an OEM",
    "TDM": "Write its observations as a table, docs/assimilate.md",
}
BINARY = {
    b"PK\x03\x04": "a zip archive, such as .xlsx or .npz",
    b"\xd0\xcf\x11\xe0": "a file of an old Excel",
    b"\x93NUMPY": "a NumPy array",
    b"\x1f\x8b": "a gzip archive",
    b"\x89HDF": "an HDF5 file",
    b"CDF": "a NetCDF file",
    b"DAF/": "a SPICE kernel",
    b"SQLite format 3": "a database of SQLite",
    b"ARROW1": "a Feather file",
    b"%PDF": "a PDF",
}
TEXTS = (
    (re.compile(r"#[a-d][PV]\s*\d{4}\s"), "precise ephemerides (SP3)"),
    (re.compile(r"H1\s+CPF\b", re.IGNORECASE), "laser ranging predictions (CPF)"),
    (re.compile(r"H1\s+CRD\b", re.IGNORECASE), "laser ranging data (CRD)"),
    (re.compile(r".{60}(RINEX|CRINEX) VERS"), "RINEX"),
    (re.compile(r".{60}(IONEX|ANTEX) VERS"), "IONEX or ANTEX"),
    (re.compile(r"%=(SNX|TRO|BIA)"), "SINEX"),
    (re.compile(r"stk\.v\.", re.IGNORECASE), "a file of STK"),
    (re.compile(r"[\[{]"), "JSON"),
    (re.compile(r"(?=.*\bMEAN_MOTION\b).*\bECCENTRICITY\b"), "mean elements as a table (OMM)"),
    (re.compile(r"\*{20,}"), "an answer of JPL Horizons"),
    (re.compile(r"(product_type|begin_of_head)\b"), "a gravity field (GFC)"),
)
"""How the first line of other formats begins."""


def kind_of(raw: bytes, file: str) -> Kind:
    """Return what a file is.

    Args:
        raw: its content.
        file: its name.

    Raises:
        UserError: another format, by its name.
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
        return "xml"
    if found := MESSAGE.match(first):
        return "oem" if found[1] == "OEM" else refuse_message(found[1], Place(file))
    if any(ELEMENTS.match(line) for line in [line for line in head if not line.startswith("#")][:2]):
        return "elements"
    for pattern, name in TEXTS if head else ():
        if pattern.match(first) or pattern.match(head[0]):
            refuse(file, name)
    return SUFFIXES.get(suffix, "table")


def refuse(file: str, received: str) -> NoReturn:
    """Say that a file is of another format; raises Fault."""
    Place(file).refuse(READ, received, "Write its samples as a table, docs/data.md")


def refuse_message(name: str, place: Place) -> NoReturn:
    """Say that a message of CCSDS is not one of an ephemeris; raises Fault."""
    received = MESSAGES.get(name, f"a CCSDS message {name}")
    place.refuse("an orbit ephemeris message (OEM)", received, REMEDIES.get(name, ""))
