"""Figures of the data doctor: the samples of each file, and the findings on them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ahnn.data.doctor import Examined, Finding
from ahnn.data.doctor.slopes import slopes
from ahnn.data.files.content import Content
from ahnn.data.files.samples import Array, Track
from ahnn.evaluation import style
from ahnn.evaluation.sinks.figure_files import FORMATS, drawn
from ahnn.files import write_atomically
from ahnn.manifest import require_own
from ahnn.progress import track

CURVES = 6
"""Maximum number of trajectories of a file in a figure."""
LOOKS = tuple(
    {"color": color, "ls": ls, "lw": 1.0}
    for ls in ("-", "--")
    for color in (style.BLUE, style.VERMILLION, style.GREEN)
)
"""Line styles of the components."""
LINES, BINS = 40, 80
"""Maximum number of findings drawn as lines, and number of bins of the histogram that replaces more lines.

More rings than that are small and have no labels.
"""
NAMED = 8
"""Maximum number of findings labelled with their row, spread over all findings."""
MANY = 5000
"""Number of samples above which a curve in a vector figure is an image."""
LABEL = np.array([60.0, 16.0])
"""Width and height of a label in pixels; a label that would overlap another is left out."""


def draw(found: Examined, folder: Path) -> None:
    """Write a figure of each file into a folder.

    Raises:
        UserError: the folder contains other files with these names.
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
    """Plot positions and stated velocities, with marks for the findings.

    A ring marks a finding on a single value. A line at its time marks any other finding; if there are many,
    a separate panel counts them. Velocities from position differences are drawn with the stated ones.
    """
    shown = content.tracks[:CURVES]
    span = max(float(np.ptp(part.times)) for part in shown)
    size, unit = style.plotted_time(span, content.units.time)
    shown = [part._replace(times=part.times / size) for part in shown]
    names = (*content.positions, *content.rates)
    ringed = rings(shown, names, findings)
    at = times_of(shown, [one for one in findings if one not in ringed])
    counted = [level for level, times in at.items() if len(times) > LINES]
    heights = [3.0] * (2 if content.rates else 1) + [1.0] * bool(counted)
    figure = style.canvas(8, sum(heights) + 0.2)
    panels = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    curves(panels, content, shown, size)
    for one, (time, value) in ringed.items():
        axes = panels[int(names.index(one.column) >= len(content.positions))]
        look = {"ms": 8 if len(ringed) <= LINES else 4, "mfc": "none", "color": style.BLACK, "zorder": 5}
        axes.plot(time, value, "o", **look, label="suspicious value")
    labelled: list[Any] = []
    named = [*ringed.items()][:: -(-len(ringed) // NAMED) or 1] if len(ringed) <= LINES else []
    for one, place in named:
        axes = panels[int(names.index(one.column) >= len(content.positions))]
        axes.autoscale_view()  # otherwise not before the figure is drawn
        pixel = axes.transData.transform(place)
        if all((abs(pixel - other) > LABEL).any() for other in labelled):
            labelled.append(pixel)
            box = {"fc": "white", "ec": "none", "alpha": 0.8, "pad": 1.0}
            look = {"xytext": (6, 6), "textcoords": "offset points", "fontsize": 8, "zorder": 6}
            axes.annotate(f"row {one.row}", place, **look, bbox=box)
    for level, ls in (("fault", "-"), ("warning", ":")):
        times = at[level]
        if level in counted:
            panels[-1].hist(times, bins=BINS, histtype="step", color=style.BLACK, ls=ls, label=f"{level}s")
            panels[-1].set_ylabel(f"findings\nin 1/{BINS}")
        else:
            for time in times:
                panels[0].axvline(time, color=style.BLACK, ls=ls, lw=0.8, alpha=0.6, label=level)
    panels[-1].set_xlabel(f"time [{unit}]")
    for axes in panels:
        axes.grid(alpha=0.3)
    few = f", the first {CURVES} of {len(content.tracks)}" if len(content.tracks) > CURVES else ""
    panels[0].set_title(f"{Path(shown[0].file).name}: {len(findings)} findings{few}")
    style.legend_below(figure, *panels)
    return figure


def curves(panels: Any, content: Content, shown: Sequence[Track], size: float) -> None:
    """Plot positions, and below them velocities or momenta, stated and from position differences.

    Args:
        panels: axes of the positions, and of the velocities.
        content: content of the file.
        shown: tracks with times in the unit of the axis.
        size: size of this unit.
    """
    n = len(content.positions)
    for c, name in enumerate((*content.positions, *content.rates)):
        look: dict[str, Any] = {**LOOKS[c % n % len(LOOKS)], "marker": ".", "ms": 3 if c < n else 0}
        for part in shown:
            many = len(part.times) > MANY
            line = style.parted(part.times, part.values[:, c])
            panels[int(c >= n)].plot(*line, **look, label=name, rasterized=many)
    panels[0].set_ylabel(f"position [{content.units.position}]")
    if not content.rates:
        return
    panels[1].set_ylabel("momentum" if content.momenta else f"velocity [{content.units.velocity}]")
    for part in shown:
        change = None if content.momenta else slopes(size * part.times, part.values[:, :n], 1)
        if change is not None:
            look = {"color": style.BLACK, "ls": "none", "marker": "+", "ms": 4, "zorder": 4}
            panels[1].plot(part.times[change.at], change.values, **look, label="change in the positions")


def rings(
    shown: Sequence[Track], names: tuple[str, ...], findings: list[Finding]
) -> dict[Finding, tuple[float, float]]:
    """Return the time and value of each finding on a value that is present."""
    found = {}
    for one in findings:
        for part in shown if one.row and one.column in names else ():
            for k in np.flatnonzero(part.rows == one.row):
                value = float(part.values[k, names.index(one.column)])
                if np.isfinite(value):
                    found[one] = (float(part.times[k]), value)
    return found


def times_of(shown: Sequence[Track], findings: list[Finding]) -> dict[str, Array]:
    """Return the times of the rows with faults and with warnings."""
    found = {}
    for level in ("fault", "warning"):
        rows = [one.row for one in findings if one.level == level and one.row]
        found[level] = np.unique(np.concatenate([part.times[np.isin(part.rows, rows)] for part in shown]))
    return found
