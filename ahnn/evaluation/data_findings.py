"""Findings of the data doctor, as a table of 80 columns and as figures."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Group, RenderableType
from rich.table import Table

from ahnn.data.doctor import Examined, Finding
from ahnn.data.doctor.slopes import slopes
from ahnn.data.files.content import Content
from ahnn.evaluation import style
from ahnn.evaluation.sinks.figure_files import FORMATS, drawn
from ahnn.files import write_atomically
from ahnn.manifest import require_own
from ahnn.progress import track

LEVELS = ("fault", "warning", "note")
SHOWN = 5
"""Maximum number of findings of a kind listed in the table; more are counted."""
CURVES = 6
"""Maximum number of trajectories of a file in a figure."""
LOOKS = tuple(
    {"color": color, "ls": ls, "lw": 1.0}
    for ls in ("-", "--")
    for color in (style.BLUE, style.VERMILLION, style.GREEN)
)
"""Line styles of the components."""


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
    """Format findings as a table of 80 columns, faults first."""
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
    for name, width in (("", 7), ("file", 12), ("row", 6), ("column", 6), ("what", 24), ("what to do", 20)):
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
    """Format the interpretation of each table column; "" for self-describing formats."""
    roles: dict[str, list[str]] = {}
    for name, role, unit in content.columns:
        roles.setdefault(role, []).append(f"{name} [{unit}]" if unit else name)
    listed = "; ".join(f"{role} {', '.join(names)}" for role, names in roles.items())
    return f"{Path(content.tracks[0].file).name}: {listed}" if roles else ""


def shortened(findings: list[Finding]) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield the table cells of findings, abbreviating similar ones by a count."""
    kinds: dict[tuple[str, str, str], list[Finding]] = {}
    for one in findings:
        kinds.setdefault((one.file, one.column, one.remedy), []).append(one)
    for (file, column, _), alike in kinds.items():
        name = Path(file).name
        for one in alike[:SHOWN]:
            yield name, str(one.row or ""), column, one.what, one.remedy
        if (more := len(alike) - SHOWN) > 0:
            yield name, "...", column, f"{more:,} more like these", ""


def draw(found: Examined, folder: Path) -> None:
    """Write a figure of each file into a folder.

    Raises:
        UserError: the folder contains other files of these names.
    """
    files = [content.tracks[0].file for content in found.contents]
    names = [Path(file).name for file in files]
    unique = [name if names.count(name) == 1 else f"{k + 1}_{name}" for k, name in enumerate(names)]
    places = [[folder / f"{name}{suffix}" for suffix in FORMATS] for name in unique]
    require_own(chain.from_iterable(places), "figures")
    for k, content in enumerate(track(found.contents, "drawing figures", len(files))):
        figure = picture(content, [one for one in found.findings if one.file == files[k]])
        for path in places[k]:
            write_atomically(path, drawn(figure, path.suffix))


def picture(content: Content, findings: list[Finding]) -> Figure:
    """Plot positions with findings, and stated velocities with velocities from position differences."""
    figure = style.canvas(8, 6 if content.rates else 3.2)
    panels = figure.subplots(2 if content.rates else 1, 1, sharex=True, squeeze=False)[:, 0]
    n, shown = len(content.positions), content.tracks[:CURVES]
    for c, name in enumerate(content.positions):
        for part in shown:
            look: dict[str, Any] = LOOKS[c % len(LOOKS)]
            panels[0].plot(part.times, part.values[:, c], **look, marker=".", ms=3, label=name)
            if content.rates:
                panels[1].plot(part.times, part.values[:, n + c], **look, label=content.rates[c])
    if content.rates:
        for part in shown:
            change = None if content.momenta else slopes(part.times, part.values[:, :n], 1)
            if change is not None:
                look = {"color": style.BLACK, "ls": "none", "marker": "+", "ms": 4, "zorder": 4}
                panels[1].plot(part.times[change.at], change.values, **look, label="change of the positions")
        rate = "momentum" if content.momenta else f"velocity [{content.units.velocity}]"
        panels[1].set_ylabel(rate)
    mark(panels[0], shown, findings)
    panels[0].set_ylabel(f"position [{content.units.position}]")
    panels[-1].set_xlabel(f"time [{content.units.time}]")
    for axes in panels:
        axes.grid(alpha=0.3)
    few = f", the first {CURVES} of {len(content.tracks)}" if len(content.tracks) > CURVES else ""
    panels[0].set_title(f"{Path(shown[0].file).name}: {len(findings)} findings{few}")
    style.legend_below(figure, *panels)
    return figure


def mark(axes: Any, shown: Any, findings: list[Finding]) -> None:
    """Draw a line at the time of each row with a finding."""
    for level, ls in (("fault", "-"), ("warning", ":")):
        rows = [one.row for one in findings if one.level == level and one.row]
        for time in np.unique(np.concatenate([part.times[np.isin(part.rows, rows)] for part in shown])):
            axes.axvline(time, color=style.BLACK, ls=ls, lw=0.8, alpha=0.6, label=level)
