"""Figures of the check of tracking data: measurements of each kind over time, by station."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ahnn.data.files import epochs
from ahnn.evaluation import style
from ahnn.evaluation.sinks.figure_files import FORMATS, drawn
from ahnn.files import require_writable, write_atomically
from ahnn.manifest import require_own
from ahnn.tracking.survey import SeriesSurvey
from ahnn.tracking.tracking_data import UNITS, TrackingData

COLORS = (style.BLUE, style.VERMILLION, style.GREEN, style.PURPLE, style.ORANGE, style.BLACK)
"""Colours of stations."""


def draw(path: Path, found: Sequence[tuple[TrackingData, list[SeriesSurvey]]], folder: Path) -> None:
    """Write a figure of each satellite of a file into a folder.

    Raises:
        UserError: the folder contains other files with these names, or cannot be written.
    """
    require_writable(folder)
    for k, (data, series) in enumerate(found):
        number = "" if len(found) == 1 else f"_{k + 1}"
        places = [folder / f"{path.name}{number}{suffix}" for suffix in FORMATS]
        require_own(places, "figures")
        figure = picture(data, series, path.name)
        for place in places:
            write_atomically(place, drawn(figure, place.suffix))


def picture(data: TrackingData, series: Sequence[SeriesSurvey], name: str) -> Figure:
    """Plot the measurements of each kind in a panel, stations in colours, with rings around the findings."""
    kinds = list(dict.fromkeys(one.kind for one in series))
    colors = dict(zip(dict.fromkeys(one.station for one in series), cycle(COLORS), strict=False))
    figure = style.canvas(8, 1.2 + 1.9 * len(kinds))
    panels = figure.subplots(len(kinds), 1, sharex=True, squeeze=False)[:, 0]
    size, unit = style.plotted_time(float(data.times[-1] - data.times[0]), "s")
    for axes, kind in zip(panels, kinds, strict=True):
        for one in (one for one in series if one.kind == kind):
            values = np.degrees(one.values) if UNITS[kind] == "rad" else one.values
            look = {"color": colors[one.station], "ms": 2.5, "ls": "none", "label": one.station}
            axes.plot(one.times / size, values, ".", **look)
            doubtful = np.union1d(one.outliers, one.impossible).astype(int)
            if len(doubtful):
                look = {"color": style.BLACK, "ms": 8, "mfc": "none", "ls": "none", "label": "check it"}
                axes.plot(one.times[doubtful] / size, values[doubtful], "o", **look)
        axes.set_ylabel(f"{kind.replace('_', ' ')} [{UNITS[kind].replace('rad', 'deg')}]")
    style.legend_below(figure, *panels)
    zero = epochs.spelled(data.epoch, utc=True)
    panels[0].set_title(f"{name}: {data.object or 'unnamed satellite'}\ntime zero {zero} UTC")
    panels[-1].set_xlabel(f"time [{unit}]")
    return figure
