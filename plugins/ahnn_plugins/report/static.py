"""Static matplotlib figures, for print and reuse."""

from __future__ import annotations

import math
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from ahnn.evaluation import style
from ahnn_plugins.report.drawing import Drawing, Panel, Series
from ahnn_plugins.report.looks import INK, OPACITY, SMALL, is_dots, look

DASHES: dict[str, Any] = {
    "solid": "-",
    "dash": (0, (4, 2)),
    "dot": (0, (1.2, 1.4)),
    "dashdot": (0, (5, 1.5, 1.2, 1.5)),
    "longdash": (0, (8, 2.5)),
    "longdashdot": (0, (8, 2, 1.2, 2)),
}
MARKERS = {"circle": "o", "square": "s", "line": "_", "x": "x"}
NARROW, SHORT = 2.5, 30.0
"""Dynamic ranges of log axes below which labels are linear, or lie between powers of ten."""
LETTERS = 10.5
"""Number of letters of a title per inch."""
MANY = 3
"""Maximum number of panels in one column; more use two."""


def to_matplotlib(drawing: Drawing) -> Figure:
    """Render a figure with its title, in the common style of the library."""
    if drawing.kind == "orbit":
        return _space(drawing)
    count = len(drawing.panels)
    columns = 2 if count > MANY else 1
    rows = math.ceil(count / columns)
    figure = style.canvas(11 if columns > 1 else 8, 1.2 + (2.3 if count > MANY else 3.0) * rows)
    square = drawing.panels[0].equal or (count == 1 and drawing.name.endswith("phase_portrait"))
    if square:
        figure.set_size_inches(6.4, 6.0)
    grid = figure.subplots(rows, columns, sharex=not drawing.panels[0].equal, squeeze=False)
    # Column by column, so that positions are to the left of velocities.
    places = list(grid.T.flat)
    for axes in places[count:]:
        axes.set_visible(False)
    for axes, panel in zip(places, drawing.panels, strict=False):
        _fill(axes, panel, drawing)
    for column in grid.T:
        column[-1].set_xlabel(_plain(drawing.panels[0].x))
    _legend(figure, places[:count])
    _title(figure, drawing.title, drawing.spread)
    return figure


def _title(figure: Figure, *lines: str) -> None:
    """Set the title, whose lines are broken at the width of the figure."""
    width = int(LETTERS * figure.get_figwidth())
    figure.suptitle("\n".join(fill(_plain(line), width) for line in lines if line), fontsize=11)


def _fill(axes: Any, panel: Panel, drawing: Drawing) -> None:
    """Draw a panel."""
    for series in panel.series:
        (_dots if is_dots(series, drawing.kind) else _line)(axes, series)
    axes.set_ylabel(_plain(panel.y))
    if panel.note:
        axes.set_title(_plain(panel.note), loc="right", fontsize=9)
    axes.grid(alpha=0.3)
    if panel.ticks:
        axes.set_xticks(range(len(panel.ticks)), [_plain(tick) for tick in panel.ticks])
        axes.set_xlim(-0.6, len(panel.ticks) - 0.4)
    if panel.log and _has_positive(panel):
        _logarithmic(axes)
    elif not panel.log:
        axes.ticklabel_format(axis="y", scilimits=(-3, 4))
    if panel.limits is not None:
        axes.set_ylim(*panel.limits)
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")


def _logarithmic(axes: Any) -> None:
    """Make the vertical axis logarithmic, with labels at powers of ten, or between them on short axes."""
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    if high < NARROW * low:
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.6g}"))
    elif high < SHORT * low:
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _line(axes: Any, series: Series) -> None:
    """Draw a curve with its band."""
    options = _line_options(series)
    if series.low is not None and series.high is not None:
        band = {"color": options["color"], "alpha": OPACITY + 0.05, "lw": 0}
        axes.fill_between(series.x.numpy(), series.low.numpy(), series.high.numpy(), **band)
    axes.plot(series.x.numpy(), series.y.numpy(), label=_label(series), **options)


def _line_options(series: Series) -> dict[str, Any]:
    found = look(series)
    order = {"truth": 4, "track": 4, "floor": 3}.get(series.role, 2)
    return {"color": _colour(found.colour), "ls": DASHES[found.dash], "lw": found.width, "zorder": order}


def _dots(axes: Any, series: Series) -> None:
    """Draw dots."""
    found = look(series)
    colour = _colour(found.colour)
    face = "none" if found.symbol == "square" else colour
    small = series.role in SMALL
    size = 3 if small else 12 if found.symbol == "line" else 6
    mark = {"marker": MARKERS[found.symbol], "ms": size, "mfc": face, "mew": 0.8 if small else 1.6}
    axes.plot(
        *(series.x.numpy(), series.y.numpy()),
        **{"ls": "none", "color": colour, "label": _label(series), "zorder": 3, **mark},
    )


def _space(drawing: Drawing) -> Figure:
    """Draw an orbit in space, with the planet to scale."""
    panel = drawing.panels[0]
    figure = style.canvas(8, 6.8)
    axes: Any = figure.add_subplot(projection="3d", computed_zorder=False)
    if panel.radius > 0:
        u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 37), np.linspace(0, np.pi, 19))
        sphere = (np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v))
        ball = {"color": style.SKY, "alpha": 0.35, "linewidth": 0, "rasterized": True, "zorder": 1}
        axes.plot_surface(*(panel.radius * part for part in sphere), **ball)
    for series in panel.series:
        assert series.z is not None
        parts = (part.numpy() for part in (series.x, series.y, series.z))
        axes.plot(*parts, label=_label(series), **_line_options(series))
    axes.set_aspect("equal")
    for name, text in zip("xyz", (panel.x, panel.y, panel.z), strict=True):
        getattr(axes, f"set_{name}label")(_plain(text), labelpad=8)
        axes.tick_params(axis=name, labelsize=8)
        axes.locator_params(axis=name, nbins=4)
    axes.tick_params(axis="z", pad=6)
    _legend(figure, [axes])
    _title(figure, drawing.title)
    return figure


def _legend(figure: Figure, panels: list[Any]) -> None:
    if any(axes.get_legend_handles_labels()[1] for axes in panels):
        style.legend_below(figure, *panels)


def _colour(name: str) -> str:
    return style.BLACK if name == INK else name


def _label(series: Series) -> str:
    """Return the label of a series; matplotlib omits labels that begin with an underscore."""
    return _plain(f" {series.label}" if series.label.startswith("_") else series.label)


def _plain(text: str) -> str:
    """Escape a text so that it is not treated as a formula."""
    return text.replace("$", r"\$")


def _has_positive(panel: Panel) -> bool:
    return any(bool((series.y > 0).any()) for series in panel.series)
