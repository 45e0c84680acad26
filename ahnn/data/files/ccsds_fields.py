"""CCSDS orbit messages that are lists of fields (OPM, OMM), in keyword = value notation and XML."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from ahnn.arguments import nearest
from ahnn.data.files.ccsds_xml import CcsdsXml
from ahnn.data.files.ephemeris import HEADER, check_version
from ahnn.data.files.table import Place

LINE = re.compile(r"(?P<key>[A-Z0-9_]+)\s*=\s*(?P<value>.*?)\s*(\[(?P<unit>[^\[\]]*)\])?")
STRUCTURE = (
    *("ndm", "opm", "omm", "header", "body", "segment", "metadata", "data", "stateVector", "meanElements"),
    *("keplerianElements", "spacecraftParameters", "covarianceMatrix", "maneuverParameters", "tleParameters"),
    "userDefinedParameters",
)
"""Container elements."""


@dataclass
class FieldMessage:
    """Fields of a message.

    Attributes:
        place: beginning of the message.
        about: description of the message.
        values: texts by keyword.
        rows: line numbers.
        units: units given with the values.
        repeated: keywords of blocks that may occur several times, such as manoeuvres.
    """

    place: Place
    about: str
    values: dict[str, str] = field(default_factory=dict)
    rows: dict[str, int] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    repeated: dict[str, None] = field(default_factory=dict)

    def at(self, key: str) -> Place:
        """Return the place of a field."""
        return self.place._replace(row=self.rows.get(key, self.place.row), column=key)

    def add(self, key: str, value: str, unit: str | None, place: Place) -> None:
        """Add a field; raises UserError for a duplicate."""
        if key == "COMMENT":
            return
        if key.startswith(("MAN_", "USER_DEFINED")):
            self.repeated[key] = None
        elif key in self.values:
            place._replace(column=key).refuse("each keyword once", "it twice")
        else:
            self.values[key], self.rows[key] = value, place.row
            if unit is not None:
                self.units[key] = unit

    def text(self, key: str) -> str:
        """Return a required field; raises UserError."""
        return self.values.get(key) or self.at(key).refuse(f"a value in {self.about}", "none")

    def require_units(self, expected: Callable[[str], str]) -> None:
        """Raise UserError for units that differ from the standard."""
        for key, unit in self.units.items():
            plain = unit.replace(" ", "").lower().replace("^", "**")
            if (wanted := expected(key)) and plain != wanted:
                self.at(key).refuse(f"units {wanted}", repr(unit))

    def unknown(self, known: Sequence[str]) -> list[str]:
        """Return the keywords absent from the standard, each with a similar known one if there is one."""
        every = (*known, *HEADER)
        return [f"{key}{nearest(key, every)}" for key in self.values if key not in every]


def field_messages(text: str, file: str, name: str) -> list[FieldMessage]:
    """Parse the messages of a text.

    Args:
        text: text of a message, or of several in one NDM.
        file: file name.
        name: OPM or OMM.

    Raises:
        UserError: another message type, or an invalid field.
    """
    if text.lstrip().startswith("<"):
        return _FieldReader(file, name).parse(text, ABOUT[name])
    lines = [(row, line.strip()) for row, line in enumerate(text.split("\n"), 1)]
    used = [(row, line) for row, line in lines if line and line.split()[0] != "COMMENT"]
    version = f"CCSDS_{name}_VERS"
    found: list[FieldMessage] = []
    for row, line in used:
        place = Place(file, row)
        cells = LINE.fullmatch(line)
        if cells is None:
            place.refuse(f"KEYWORD = value in {ABOUT[name]}", repr(line))
        if cells["key"] == version:
            check_version(cells["value"], place, f"{ABOUT[name]},")
            found.append(FieldMessage(place, ABOUT[name]))
        elif not found:
            place.refuse(f"{version} first", repr(line))
        else:
            found[-1].add(cells["key"], cells["value"], cells["unit"], place)
    return found


ABOUT = {"OPM": "an orbit parameter message (OPM)", "OMM": "an orbit mean-elements message (OMM)"}


class _FieldReader(CcsdsXml[FieldMessage]):
    """Collects the fields of messages of one name."""

    def __init__(self, file: str, name: str) -> None:
        super().__init__(file)
        self.name = name

    def start(self, tag: str) -> None:
        """Begin an element; raises UserError for elements that do not belong to a message."""
        place, about = self.place, ABOUT[self.name]
        if tag == self.name.lower():
            check_version(self.attributes.get("version", "2.0"), place, f"{about},")
            self.found.append(FieldMessage(place, about))
        elif tag not in STRUCTURE and not (self.found and self.path and self.path[-1] in STRUCTURE):
            place.refuse(about, f"one with <{tag}>")
        elif tag in ("opm", "omm", "segment") and tag in self.path:
            place.refuse(about, f"one with <{tag}> in <{tag}>")

    def end(self, tag: str, text: str) -> None:
        """End an element, and add its text."""
        if tag not in STRUCTURE and self.found:
            self.found[-1].add(tag, text, self.attributes.get("units"), self.place)
