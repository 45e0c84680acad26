"""Segments of tracking data messages in XML (CCSDS 505.0-B) as text."""

from __future__ import annotations

from ahnn.data.files.ccsds_xml import CcsdsXml
from ahnn.data.files.ephemeris import check_version
from ahnn.data.files.table import Place
from ahnn.tracking.formats.tdm_segment import HEADER, VERSIONS, TdmSegment

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
    return _TdmReader(file).parse(text, "a tracking data message <tdm> with a <segment>")


class _TdmReader(CcsdsXml[TdmSegment]):
    """Collects metadata and observations."""

    def __init__(self, file: str) -> None:
        super().__init__(file)
        self.observation: dict[str, str] = {}

    def start(self, tag: str) -> None:
        """Begin an element; raises UserError for an unexpected element."""
        place = self.place
        inside = self.path[-1] if self.path else ""
        if tag not in STRUCTURE and inside not in ("metadata", "observation"):
            place.refuse("a tracking data message <tdm>", f"one with <{tag}>")
        if tag == "tdm":
            check_version(self.attributes.get("version", "2.0"), place, "TDM", VERSIONS)
        elif tag == "segment":
            self.found.append(TdmSegment(place))
        elif tag in ("metadata", "data", "observation"):
            if not self.found:
                place.refuse(f"a <segment> around <{tag}>", "none")
            self.observation = {}
        unit, known = self.attributes.get("units"), UNITS.get(tag, ())
        if unit is not None and known and unit not in known:
            place._replace(column=tag).refuse(f"units {' or '.join(known)}", repr(unit))
        if tag == "RANGE" and unit is not None and unit != self.found[-1].meta.get("RANGE_UNITS", "km"):
            place._replace(column=tag).refuse("the units given by RANGE_UNITS", repr(unit))

    def end(self, tag: str, text: str) -> None:
        """End an element, and store its text or the complete observation."""
        place = self.place
        inside = self.path[-1] if self.path else ""
        if tag == "COMMENT":
            return
        if tag == "observation":
            self.observed(place)
        elif inside == "metadata":
            self.found[-1].say(tag, text, place)
        elif inside == "observation":
            if tag in self.observation:
                place._replace(column=tag).refuse("each element once", "it twice")
            self.observation[tag] = text

    def observed(self, place: Place) -> None:
        """Add an observation to the segment; raises UserError unless it has an epoch and a value."""
        found = dict(self.observation)
        epoch = found.pop("EPOCH", "")
        if not epoch or len(found) != 1:
            place.refuse("EPOCH and one value in an <observation>", ", ".join(self.observation) or "nothing")
        ((key, value),) = found.items()
        self.found[-1].record(key, epoch, value, place)
