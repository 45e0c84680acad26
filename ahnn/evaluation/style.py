"""Figure style: colour-blind safe colours, time and error axes, legends.

The colours are from Okabe & Ito (2008); line styles differ too, for print without colour.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from torch import Tensor

from ahnn.evaluation.case import Case
from ahnn.labels import components, quantity

ORANGE, SKY, GREEN, BLUE = "#E69F00", "#56B4E9", "#009E73", "#0072B2"
VERMILLION, PURPLE, BLACK = "#D55E00", "#CC79A7", "#000000"

TRUTH: dict[str, Any] = {"color": BLACK, "ls": (0, (4, 3)), "lw": 1.0, "zorder": 4}
TRACK: dict[str, Any] = TRUTH | {"ls": "-", "lw": 0.7}
"""Line style of true paths in the plane: the dashes of several revolutions would fill one another's gaps."""
MODEL: dict[str, Any] = {"color": VERMILLION, "ls": "-", "lw": 1.8}
FLOOR: dict[str, Any] = {"color": BLUE, "ls": (0, (6, 1.5, 1.5, 1.5)), "lw": 1.5, "zorder": 3}
ALONE: dict[str, Any] = {"color": GREEN, "ls": (0, (1.5, 1.2)), "lw": 1.8, "zorder": 3}
"""Line styles of truth, model, floor, and model without estimator.

Dashed lines are drawn over the solid one, so that both are visible where they coincide.
"""

BAND = SKY
ERRORS = "viridis"
"""Colour map of errors along a path."""

LOST = 1e30
"""Absolute value from which on a prediction is treated as lost and excluded from axis limits."""
NAMES = ("position", "velocity")
HOURS, DAYS = 7200.0, 10 * 86400.0
"""Time spans in s above which axes have hours, and days."""
FEWEST = 2
"""Number of powers of ten on a logarithmic axis below which twice and five times them are labelled, too."""
PARTED = 5.0
"""Steps longer than this multiple of the median one are not bridged by a line."""


class Axis(NamedTuple):
    """Times of samples, (T,), and their unit."""

    time: Tensor
    unit: str

    def at(self, samples: Tensor) -> Axis:
        """Return the times of samples by index."""
        return Axis(self.time[samples], self.unit)


def time_axis(case: Case) -> Axis:
    """Return the times since the start of the test trajectories, in hours for long time spans in seconds.

    If trajectories have different times, they are averaged over those that contain the sample.
    """
    times = case.test.times
    elapsed = (times - times[:, :1]).nanmean(0)
    typical = case.dt.nanmean() if isinstance(case.dt, Tensor) else case.dt
    regular = typical * torch.arange(len(elapsed), dtype=torch.float64)
    return _readable(torch.where(elapsed.isnan(), regular, elapsed), case.space.units.time)


def own_times(case: Case) -> Axis:
    """Return the times (B, T) since the start of each test trajectory, NaN where missing."""
    times, there = case.test.times - case.test.times[:, :1], case.test.states.isfinite().any(-1)
    return _readable(times.where(there, torch.nan), case.space.units.time)


def _readable(time: Tensor, unit: str) -> Axis:
    """Convert long time spans in seconds to hours or days."""
    size, name = plotted_time(float(time.nan_to_num(0.0).max()), unit)
    return Axis(time / size, name)


def plotted_time(span: float, unit: str) -> tuple[float, str]:
    """Return the size of the unit of a time axis and its name: hours or days for long spans in seconds."""
    if unit != "s" or span <= HOURS:
        return 1.0, unit
    return (3600.0, "h") if span <= DAYS else (86400.0, "d")


def reference(case: Case) -> str:
    """Return the label of a case's trajectories: the truth, data, or measurements."""
    if case.fitted is not None:
        return "measurements"
    return "test data" if case.truth is None else "truth"


class ShownFigure(Figure):
    """Figure that notebooks show even if pyplot is not imported."""

    def _repr_png_(self) -> bytes:
        self.savefig(content := io.BytesIO(), format="png")
        return content.getvalue()


def canvas(width: float, height: float) -> Figure:
    """Return an empty figure of the given size in inches."""
    return ShownFigure(figsize=(width, height), layout="constrained")


def label_time(axes: Any, axis: Axis) -> None:
    """Label and limit a horizontal axis of time."""
    axes.set_xlabel(f"time [{axis.unit}]")
    axes.set_xlim(0, float(axis.time.nan_to_num(0.0).max()) or None)
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))


def label_errors(case: Case, panels: Iterable[Any]) -> None:
    """Label the vertical axes of a panel of positions and, if present, of a panel of velocities."""
    for axes, name in zip(panels, NAMES, strict=False):
        called, unit = quantity(case.space, name)
        axes.set_ylabel(f"{called} error [{unit}]")


def state_labels(case: Case) -> list[str]:
    """Return the names of the state components with their units, momenta as velocities if applicable."""
    return components(case.space)


def legend_below(figure: Figure, *panels: Any) -> None:
    """Put one legend below a figure that lists each label of its panels once."""
    entries: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    longest = max((len(label) for label in entries), default=0)
    columns = max(1, min(len(entries), int(figure.get_figwidth() * 13 / (longest + 8))))
    figure.legend(entries.values(), entries, loc="outside lower center", ncols=columns, frameon=False)


def logarithmic(axes: Any, first: int, others: Iterable[Any] = ()) -> None:
    """Make the vertical axis logarithmic, scaled to the entries of the curves from `first` on.

    Args:
        axes: axes with lines.
        first: first entry considered in the scaling: errors from a true start begin at zero.
        others: further axes that share the scale.
    """
    curves = [line for each in (axes, *others) for line in each.get_lines()]
    series = [torch.as_tensor(line.get_ydata()).double() for line in curves]
    values = torch.cat([torch.zeros(1).double(), *(each[min(first, len(each) - 1) :] for each in series)])
    values = values[values.isfinite() & (values > 0)]
    axes.grid(alpha=0.3)
    if not len(values):
        return
    low, high = float(values.min()) / 1.3, float(values.max()) * 1.3
    axes.set_ylim(low, min(high, low * 1e18))  # so that a lost prediction does not flatten all other curves
    axes.set_yscale("log")
    decades = math.floor(math.log10(high)) - math.ceil(math.log10(low)) + 1
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if decades < FEWEST else (1.0,)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def parted(times: Any, *columns: Any) -> list[Any]:
    """Return times (T,) and columns (T,) with a NaN in each long step, so that a line does not bridge it."""
    steps = np.diff(times)
    after = np.flatnonzero(steps > PARTED * np.median(steps)) + 1 if len(steps) else []
    return [np.insert(times, after, times[after]), *(np.insert(one, after, np.nan) for one in columns)]


def near(axes: Any, points: Tensor) -> None:
    """Limit the axes to the vicinity of points (..., 2) if other curves extend far beyond."""
    points = points.flatten(0, -2)
    points = points[points.isfinite().all(-1)]
    if not len(points):
        return
    low, high = points.amin(0), points.amax(0)
    for name, a, b in zip("xy", low.tolist(), high.tolist(), strict=True):
        least, most = getattr(axes, f"get_{name}lim")()
        size = (b - a) or 1.0
        if most - least > 3 * size:
            getattr(axes, f"set_{name}lim")(a - 0.5 * size, b + 0.5 * size)


def frame(axes: Any, curves: Iterable[Tensor], *, symmetric: bool) -> None:
    """Fit the vertical limits to curves (T,), with a margin; leave them unchanged without finite values."""
    values = torch.cat([curve[curve.isfinite()] for curve in curves])
    if not len(values):
        return
    low, high = float(values.min()), float(values.max())
    if symmetric:
        high = max(abs(low), abs(high))
        low = -high
    margin = 0.08 * (high - low) or 1.0
    axes.set_ylim(low - margin, high + margin)
