"""CCSDS orbit ephemeris messages in XML (CCSDS 505.0-B), reading and writing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from ahnn.data.files import epochs
from ahnn.data.files.ccsds_xml import CcsdsXml
from ahnn.data.files.ephemeris import (
    ACCELERATION,
    ALONE,
    COMPONENTS,
    HEADER,
    Ephemeris,
    MessageBlock,
    check_version,
)
from ahnn.data.files.kinds import MESSAGES, refuse_message
from ahnn.data.files.table import Place

TRIANGLE = [f"C{a}_{b}" for k, a in enumerate(COMPONENTS) for b in COMPONENTS[: k + 1]]
GROUPS: dict[str, tuple[str, ...]] = {
    "metadata": (),
    "stateVector": ("EPOCH", *COMPONENTS, *ACCELERATION),
    "covarianceMatrix": ("EPOCH", "COV_REF_FRAME", *TRIANGLE),
}
"""Elements with text, by container; metadata accept any."""
STRUCTURE = ("ndm", "oem", "header", "body", "segment", "data", "COMMENT", *HEADER)


def unit_of(tag: str) -> str:
    """Return the standard unit of an element, or ""."""
    if tag in (*COMPONENTS, *ACCELERATION):
        return "km" + {0: "", 1: "/s", 2: "/s**2"}[2 if "DDOT" in tag else tag.count("DOT")]
    return "km**2" + {0: "", 1: "/s", 2: "/s**2"}[tag.count("DOT")] if tag in TRIANGLE else ""


def blocks_of(text: str, file: str) -> list[MessageBlock]:
    """Split a message into segments of text.

    Raises:
        UserError: not XML, non-standard units, or an incomplete state.
    """
    reader = _OemReader(file)
    blocks = reader.parse(text, "an orbit ephemeris message <oem> with a <segment>")
    blocks[0].comments = reader.comments
    return blocks


class _OemReader(CcsdsXml[MessageBlock]):
    """Collects the texts of elements and processes them at the end of each group."""

    def __init__(self, file: str) -> None:
        super().__init__(file)
        self.texts: dict[str, str] = {}
        self.group, self.row, self.comments = "", 0, list[str]()

    @property
    def block(self) -> MessageBlock:
        """Current segment; raises UserError outside of segments."""
        return self.found[-1] if self.found else self.place.refuse("a <segment> around it", "none")

    def start(self, tag: str) -> None:
        """Begin an element; raises UserError for elements that do not belong to an ephemeris."""
        place = self.place
        if tag.upper() in MESSAGES:
            refuse_message(tag.upper(), place)
        if tag == "oem":
            check_version(self.attributes.get("version", "2.0"), place)
        elif tag == "segment":
            self.found.append(MessageBlock(place))
        elif tag in GROUPS:
            self.group, self.texts, self.row = tag, {}, place.row
        elif tag not in (GROUPS[self.group] or (tag,) if self.group else STRUCTURE) and tag != "COMMENT":
            place.refuse("an orbit ephemeris message <oem>", f"one with <{tag}>", ALONE)
        wanted = unit_of(tag)
        if wanted and self.attributes.get("units", wanted).lower().replace("^", "**") != wanted:
            place._replace(column=tag).refuse(f"units {wanted}", repr(self.attributes["units"]))

    def end(self, tag: str, text: str) -> None:
        """End an element: a text, or a group of them."""
        if tag in GROUPS:
            self.add(tag)
            self.group = ""
        elif tag == "COMMENT":
            self.comments.append(text)
        elif self.group:
            if tag in self.texts:
                self.place._replace(column=tag).refuse("each element once", "it twice")
            self.texts[tag] = text

    def add(self, group: str) -> None:
        """Add a group of texts to the segment."""
        if group == "metadata":
            for key, value in self.texts.items():
                self.block.say(key, value, Place(self.file, self.row))
        elif group == "stateVector":
            self.block.vectors.append((self.row, self.taken(("EPOCH", *COMPONENTS))))
            self.block.unused |= dict.fromkeys(key for key in ACCELERATION if key in self.texts)
        else:
            epoch, *cells = self.taken(("EPOCH", *TRIANGLE))
            self.block.matrices.append((self.row, epoch, self.texts.get("COV_REF_FRAME", ""), cells))

    def taken(self, names: tuple[str, ...]) -> list[str]:
        """Return the texts of some elements; raises UserError for missing ones."""
        for name in names:
            if name not in self.texts:
                Place(self.file, self.row, name).refuse("the element", "none")
        return [self.texts[name] for name in names]


def written(
    ephemerides: Iterable[Ephemeris],
    originator: str = "ahnn",
    created: str | None = None,
    comments: Iterable[str] = (),
) -> str:
    """Format a message of version 2.0 in XML; arguments as in `oem.written`."""
    message = Element("oem", id="CCSDS_OEM_VERS", version="2.0")
    about = {"CREATION_DATE": created or epochs.now(), "ORIGINATOR": originator}
    _group(message, "header", about, comments)
    body = SubElement(message, "body")
    for one in ephemerides:
        segment = SubElement(body, "segment")
        _group(segment, "metadata", one.metadata())
        _data(SubElement(segment, "data"), one)
    indent(message)
    return tostring(message, encoding="unicode", xml_declaration=True) + "\n"


def _data(parent: Element, one: Ephemeris) -> None:
    """Add states and covariances."""
    for time, state in zip(one.times, one.states, strict=True):
        numbers = zip(COMPONENTS, (f"{value:.15e}" for value in state), strict=True)
        _group(parent, "stateVector", {"EPOCH": one.epoch(float(time)), **dict(numbers)})
    for covariance in one.covariances:
        about = {"EPOCH": one.epoch(covariance.time), "COV_REF_FRAME": covariance.frame or one.frame}
        cells = np.asarray(covariance.matrix)[np.tril_indices(len(COMPONENTS))]
        numbers = zip(TRIANGLE, (f"{value:.15e}" for value in cells), strict=True)
        _group(parent, "covarianceMatrix", {**about, **dict(numbers)})


def _group(parent: Element, tag: str, texts: Mapping[str, str], comments: Iterable[str] = ()) -> None:
    """Add a container element with comments and text elements."""
    group = SubElement(parent, tag)
    for line in comments:
        SubElement(group, "COMMENT").text = line
    for name, text in texts.items():
        SubElement(group, name).text = text
