"""Parsing of file bytes to content, in any supported format."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from ahnn.data.files import (
    cpf,
    elements,
    ephemeris,
    frames,
    kinds,
    messages,
    omm,
    opm,
    parquet,
    sidecar,
    sp3,
)
from ahnn.data.files.content import Content, joined
from ahnn.data.files.raw import content_of, decoded
from ahnn.data.files.table import Note, Place, Remark, Sheet, read_csv, refuse
from ahnn.data.files.tabular import of_sheet


class FileReading(NamedTuple):
    """Reading options.

    Attributes:
        frame: target frame of positions and velocities; None: no transformation.
        step, duration: sampling of orbits propagated from element sets, in seconds; None without element
            sets.
        of_starts: whether only initial states are read, without remarks on training.
    """

    frame: str | None = None
    step: float | None = None
    duration: float | None = None
    of_starts: bool = False


def bytes_of(path: Path, key: str = "") -> tuple[bytes, bytes | None]:
    """Read a file, which a key names, and, if present, its sidecar; raises UserError."""
    raw, aside = content_of(path, key), sidecar.beside(path)
    return raw, content_of(aside) if aside != path and aside.is_file() else None


def parsed(path: Path, raw: bytes, aside: bytes | None, reading: FileReading, note: Note = refuse) -> Content:
    """Parse a file.

    Args:
        path: path of the file.
        raw: content of the file.
        aside: content of its sidecar, or None.
        reading: reading options.
        note: callback for recoverable faults and unused content.

    Raises:
        UserError: the first unrecoverable fault.
    """
    file = str(path)
    kind = kinds.kind_of(raw, file)
    beside, of_starts = sidecar.beside(path), reading.of_starts
    if kind in kinds.TABLES:
        sheet, said = table_of(path, raw, aside, kind, note)
        found = of_sheet(sheet, said, of_starts=of_starts, note=note)
        return turned([found], [sheet.place], reading)
    if kind in kinds.TRACKING:
        remedy = "It contains no trajectories: system=sightings learns from it (docs/tracking.md)"
        Place(file).refuse(kinds.READ, kinds.ABOUT[kind], remedy)
    if aside is not None:
        note(Remark(Place(str(beside)), f"not used: {path.name} states its own units and frame"))
    text = decoded(raw, path)
    if kind in ("elements", "omm"):
        read = elements.content if kind == "elements" else omm.omm_content
        found = read(text, file, reading.step, reading.duration, note=note)
        return turned([found], [Place(file)], reading)
    if kind in ("cpf", "sp3"):
        read = cpf.cpf_content if kind == "cpf" else sp3.sp3_content
        return turned([read(text, file, note=note)], [Place(file)], reading)
    blocks = (opm.opm_blocks if kind == "opm" else messages.blocks_of)(text, file, note)
    parts = ephemeris.contents(blocks, of_starts=of_starts, note=note)
    return turned(parts, [block.place for block in blocks], reading)


def table_of(
    path: Path, raw: bytes, aside: bytes | None, kind: kinds.Kind, note: Note = refuse
) -> tuple[Sheet, sidecar.Sidecar]:
    """Return a table with the units that its sidecar adds, and the sidecar; arguments as in `parsed`."""
    if kind == "parquet":
        sheet = parquet.read_parquet(raw, str(path), note)
    else:
        sheet = read_csv(decoded(raw, path), str(path), note)
    beside = sidecar.beside(path)
    said = sidecar.Sidecar() if aside is None else sidecar.parse(decoded(aside, beside), str(beside))
    return sheet._replace(header=sidecar.with_units(sheet.header, said, sheet.place)), said


def turned(parts: list[Content], places: list[Place], reading: FileReading) -> Content:
    """Transform the parts of a file to a common frame; raises UserError if impossible."""
    if reading.frame is not None:
        parts = [frames.turned(part, reading.frame, at.file) for part, at in zip(parts, places, strict=True)]
    return joined(parts, places) if len(parts) > 1 else parts[0]
