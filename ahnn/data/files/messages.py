"""Files of orbit ephemeris and parameter messages, in either notation."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from pathlib import Path

from ahnn.data.files import kinds, oem, oem_xml, opm
from ahnn.data.files.ephemeris import Ephemeris, MessageBlock, ephemeris, remarks
from ahnn.data.files.raw import content_of, decoded
from ahnn.data.files.table import Note, Place, refuse
from ahnn.files import write_atomically

SUFFIXES = (".oem", ".xml")
COMMENT = 200
"""Width of comments; lines of a message have at most 254 characters (CCSDS 502.0-B)."""


def blocks_of(text: str, file: str, note: Note = refuse) -> list[MessageBlock]:
    """Parse the segments of a message, in XML if it begins as such, else in keyword = value notation."""
    return oem_xml.blocks_of(text, file) if text.lstrip().startswith("<") else oem.blocks_of(text, file, note)


def read_oem(path: str | Path) -> list[Ephemeris]:
    """Read the segments of an orbit ephemeris message.

    Raises:
        UserError: invalid content; the message gives its line number.
    """
    path = Path(path)
    raw = content_of(path)
    if (kind := kinds.kind_of(raw, str(path))) not in ("oem", "xml"):
        Place(str(path)).refuse("an orbit ephemeris message (OEM)", kinds.ABOUT[kind])
    return _ephemerides(blocks_of(decoded(raw, path), str(path)))


def read_opm(path: str | Path) -> list[Ephemeris]:
    """Read the states of an orbit parameter message, each as an ephemeris of one state.

    Raises:
        UserError: invalid content; the message gives its line number.
    """
    path = Path(path)
    raw = content_of(path)
    if (kind := kinds.kind_of(raw, str(path))) != "opm":
        Place(str(path)).refuse("an orbit parameter message (OPM)", kinds.ABOUT[kind])
    return _ephemerides(opm.opm_blocks(decoded(raw, path), str(path)))


def _ephemerides(blocks: list[MessageBlock]) -> list[Ephemeris]:
    """Convert segments to numbers; unused content is logged."""
    for remark in remarks(blocks):
        refuse(remark)
    return [ephemeris(block) for block in blocks]


def write_oem(
    path: str | Path,
    ephemerides: Iterable[Ephemeris],
    originator: str = "ahnn",
    comments: Iterable[str] = (),
) -> None:
    """Write an orbit ephemeris message atomically.

    Args:
        path: path of the file, in XML if it ends in .xml, otherwise in keyword = value notation.
        ephemerides: one ephemeris per segment.
        originator: originator of the message.
        comments: texts for comments in the header; long ones are wrapped.
    """
    lines = [line for text in comments for line in _comment_lines(text)]
    notation = oem_xml if Path(path).suffix.lower() == ".xml" else oem
    write_atomically(Path(path), notation.written(ephemerides, originator, comments=lines).encode())


def _comment_lines(text: str) -> list[str]:
    """Return a text as the contents of comment lines, in printable ASCII characters."""
    plain = "".join(
        sign if sign.isascii() and (sign.isprintable() or sign.isspace()) else "?" for sign in text
    )
    return textwrap.wrap(plain, COMMENT)
