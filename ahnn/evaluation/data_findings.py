"""Findings of the data doctor, as a table 80 characters wide."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rich.console import Group, RenderableType
from rich.table import Table

from ahnn.data.doctor import Examined, Finding
from ahnn.data.files.content import Content
from ahnn.data.reference import Reference

LEVELS = ("fault", "warning", "note")
SHOWN = 5
"""Maximum number of similar findings listed in the table; the rest are counted."""
LISTED = 20
"""Maximum number of rows named of the rest."""
AGAIN = "as above"
"""In place of a remedy that stands above."""
FILE = 12, 20
"""Minimum and maximum width of file names, which are never broken; longer ones lack their middle."""
SPATIAL = 3
"""Number of positions in space, whose frame is stated."""
NARROW = 6
"""Minimum width of the names of columns; the descriptions give four more to longer names."""


def checkup(found: Examined) -> RenderableType:
    """Format the findings as a table, faults first, with a summary line."""
    counts = counted(found.findings)
    samples = sum(len(part.times) for content in found.contents for part in content.tracks)
    files = {finding.file for finding in found.findings} | {c.tracks[0].file for c in found.contents}
    many = "s" * (samples != 1)
    head = f"{len(files)} file{'s' * (len(files) != 1)}, {samples:,} sample{many}: {counts}"
    taken = [line for content in found.contents if (line := columns(content))]
    return Group(*([listed(found.findings), ""] if found.findings else []), *taken, head)


def listed(findings: list[Finding]) -> RenderableType:
    """Format findings as a table 80 characters wide, faults first."""
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
    longest = max((len(word) for one in findings for word in one.column.split()), default=0)
    wide = min(max(longest, NARROW), NARROW + 4)
    file = min(max([FILE[0], *(len(Path(one.file).name) for one in findings)]), FILE[1])
    widths = (7, file, 6, wide, 24 + NARROW + FILE[0] - wide - file, 20)
    for name, width in zip(("", "file", "row", "column", "what", "what to do"), widths, strict=True):
        table.add_column(name, width=width, overflow="fold", justify="right" if name == "row" else "left")
    for level in LEVELS:
        part = [one for one in findings if one.level == level]
        for cells in shortened(sorted(part, key=lambda one: (one.file, one.row))):
            table.add_row(level, *cells)
    return table


def counted(findings: list[Finding]) -> str:
    """Format the number of findings of each level."""
    counts = ((level, sum(one.level == level for one in findings)) for level in LEVELS)
    return ", ".join(f"{count} {level}{'s' * (count != 1)}" for level, count in counts)


def columns(content: Content) -> str:
    """Format the interpretation of each table column, and the frame; "" for self-describing formats."""
    roles: dict[str, list[str]] = {}
    for name, role, unit in content.columns:
        roles.setdefault(role, []).append(f"{name} [{unit}]" if unit else name)
    listed = "; ".join(f"{role} {', '.join(names)}" for role, names in roles.items())
    reference = Reference.of(content.frame)._replace(epoch=None).described()
    stated = f"; {reference}" if reference and len(content.positions) == SPATIAL else ""
    return f"{Path(content.tracks[0].file).name}: {listed}{stated}" if roles else ""


def shortened(findings: list[Finding]) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield the table cells of findings, of similar ones the largest, and the rows of those beyond `SHOWN`.

    A remedy is stated once for consecutive findings of a file.
    """
    above = ("", "")
    kinds: dict[tuple[str, str, str], list[Finding]] = {}
    for one in findings:
        kinds.setdefault((one.file, one.column, one.remedy), []).append(one)
    for (file, column, remedy), alike in kinds.items():
        name = fitting(Path(file).name)
        ordered = sorted(alike, key=lambda one: -one.size)
        for one in ordered[:SHOWN]:
            yield name, str(one.row or ""), column, one.what, AGAIN if (file, remedy) == above else remedy
            above = file, remedy
        if rest := ordered[SHOWN:]:
            rows = ", ".join(str(one.row) for one in sorted(rest, key=lambda one: one.row)[:LISTED])
            known = f", in rows {rows}{', ...' * (len(rest) > LISTED)}" if rest[0].row else ""
            yield name, "...", column, f"{len(rest):,} more like these{known}", ""


def fitting(name: str) -> str:
    """Return a file name of at most the width of its column, long ones with `...` in the middle."""
    most = FILE[1]
    half = (most - 3) // 2
    return name if len(name) <= most else f"{name[: most - 3 - half]}...{name[-half:]}"
