"""From the bytes of a file to its content, whatever its format."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from ahnn.data.files import elements, ephemeris, frames, messages, parquet, sidecar
from ahnn.data.files.content import Content
from ahnn.data.files.raw import content_of, decoded
from ahnn.data.files.table import Note, Place, read_csv, refuse
from ahnn.data.files.tabular import of_sheet

TEXTS = (".csv", ".tsv", ".txt")
TABLES = (*TEXTS, parquet.SUFFIX)
SUFFIXES = (*TABLES, elements.SUFFIX, *messages.SUFFIXES)


class Reading(NamedTuple):
    """How files are read.

    Attributes:
        weighed: whether a mass is stated.
        frame: into which positions and velocities are turned; None leaves them as they are.
        step, duration: of what is propagated from element sets, in seconds; None where there are none.
    """

    weighed: bool = False
    frame: str | None = None
    step: float | None = None
    duration: float | None = None


def bytes_of(path: Path) -> tuple[bytes, bytes | None]:
    """Return what is in a file and, if it is a table that has one, in its sidecar; raises UserError."""
    raw, aside = content_of(path), sidecar.beside(path)
    beside = path.suffix.lower() in TABLES and aside.is_file()
    return raw, content_of(aside) if beside else None


def parsed(path: Path, raw: bytes, aside: bytes | None, reading: Reading, note: Note = refuse) -> Content:
    """Return the content of a file.

    Args:
        path: of the file.
        raw: what is in it.
        aside: what is in its sidecar; None without.
        reading: how it is read.
        note: of a fault that can be passed over.

    Raises:
        UserError: the first fault that cannot.
    """
    file, suffix = str(path), path.suffix.lower()
    if suffix not in SUFFIXES:
        Place(file).refuse(f"a file {', '.join(SUFFIXES)}", repr(path.suffix))
    said = sidecar.Sidecar()
    if aside is not None:
        beside = sidecar.beside(path)
        said = sidecar.parse(decoded(aside, beside), str(beside))
    if suffix == parquet.SUFFIX:
        found = of_sheet(parquet.read_parquet(raw, file), said, weighed=reading.weighed, note=note)
    elif suffix in messages.SUFFIXES:
        blocks = messages.blocks_of(decoded(raw, path), file, note)
        found = ephemeris.content(blocks, weighed=reading.weighed, note=note)
    elif elements.are_elements(text := decoded(raw, path), suffix):
        given = (reading.step, reading.duration)
        found = elements.content(text, file, *given, weighed=reading.weighed, note=note)
    else:
        found = of_sheet(read_csv(text, file, note), said, weighed=reading.weighed, note=note)
    return found if reading.frame is None else frames.turned(found, reading.frame, file)
