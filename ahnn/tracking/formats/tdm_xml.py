"""Segments of tracking data messages in XML (CCSDS 505.0-B) as text."""

from __future__ import annotations

from xml.parsers import expat

from ahnn.data.files.table import Place
from ahnn.tracking.formats.tdm_segment import HEADER, TdmSegment, require_version

STRUCTURE = ("ndm", "tdm", "header", "body", "segment", "metadata", "data", "observation", "COMMENT", *HEADER)
UNITS = {
    "RANGE": ("km", "s", "RU"),
    "DOPPLER_INSTANTANEOUS": ("km/s",),
    "DOPPLER_INTEGRATED": ("km/s",),
    "ANGLE_1": ("deg",),
    "ANGLE_2": ("deg",),
    "PRESSURE": ("hPa",),
    "TEMPERATURE": ("K",),
    "RHUMIDITY": ("%",),
}
"""Valid units of data in the attribute `units`."""


def xml_segments(text: str, file: str) -> list[TdmSegment]:
    """Return the segments of a message in XML.

    Raises:
        UserError: not XML, other units, or an observation that is not an epoch and a value.
    """
    reader = _TdmReader(file)
    try:
        reader.parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        Place(file, error.lineno).refuse("XML", expat.ErrorString(error.code))
    if not reader.segments:
        Place(file).refuse("a tracking data message <tdm> with a <segment>", "none")
    return reader.segments


class _TdmReader:
    """Parser handlers that collect metadata and observations."""

    def __init__(self, file: str) -> None:
        self.file, self.text, self.path = file, "", list[str]()
        self.segments: list[TdmSegment] = []
        self.observation: dict[str, str] = {}
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = self.more
        self.parser.EntityDeclHandler = self.entity

    @property
    def place(self) -> Place:
        """Current place of the parser."""
        return Place(self.file, self.parser.CurrentLineNumber)

    def start(self, name: str, attributes: dict[str, str]) -> None:
        """Begin an element; raises UserError for an unexpected element."""
        tag, place = name.rpartition(":")[2], self.place
        inside = self.path[-1] if self.path else ""
        if tag not in STRUCTURE and inside not in ("metadata", "observation"):
            place.refuse("a tracking data message <tdm>", f"one with <{tag}>")
        if tag == "tdm":
            require_version(attributes.get("version", "2.0"), place)
        elif tag == "segment":
            self.segments.append(TdmSegment(place))
        elif tag in ("metadata", "data", "observation"):
            if not self.segments:
                place.refuse(f"a <segment> around <{tag}>", "none")
            self.observation = {}
        unit, known = attributes.get("units"), UNITS.get(tag, ())
        if unit is not None and known and unit not in known:
            place._replace(column=tag).refuse(f"units {' or '.join(known)}", repr(unit))
        if tag == "RANGE" and unit is not None and unit != self.segments[-1].meta.get("RANGE_UNITS", "km"):
            place._replace(column=tag).refuse("the units given by RANGE_UNITS", repr(unit))
        self.path.append(tag)
        self.text = ""

    def more(self, text: str) -> None:
        """Add to the text of an element."""
        self.text += text

    def entity(self, *_: object) -> None:
        """Reject entities, which could expand a small file into a huge one."""
        self.place.refuse("no custom entities", "one")

    def end(self, _: str) -> None:
        """End an element, and store its text or the complete observation."""
        tag, place = self.path.pop(), self.place
        inside = self.path[-1] if self.path else ""
        if tag == "COMMENT":
            return
        if tag == "observation":
            self.observed(place)
        elif inside == "metadata":
            self.segments[-1].say(tag, self.text.strip(), place)
        elif inside == "observation":
            if tag in self.observation:
                place._replace(column=tag).refuse("each element once", "it twice")
            self.observation[tag] = self.text.strip()

    def observed(self, place: Place) -> None:
        """Add an observation to the segment; raises UserError unless it has an epoch and a value."""
        found = dict(self.observation)
        epoch = found.pop("EPOCH", "")
        if not epoch or len(found) != 1:
            place.refuse("EPOCH and one value in an <observation>", ", ".join(self.observation) or "nothing")
        ((key, value),) = found.items()
        self.segments[-1].record(key, epoch, value, place)
