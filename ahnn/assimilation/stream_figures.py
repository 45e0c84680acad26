"""Figures of an assimilation: innovations with bands, consistency, and standard deviations."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle

import numpy as np
from matplotlib.figure import Figure

from ahnn.assimilation.assimilation_record import Array, AssimilationRecord
from ahnn.data.reference import Reference
from ahnn.estimation.consistency import band
from ahnn.evaluation import style
from ahnn.labels import headed
from ahnn.types import Space

MOST, MARGIN = 0.98, 1.5
"""Fraction of the accepted innovations within an axis divided by the margin; triangles mark those beyond."""
AVERAGED = 50
"""Number of readings in a moving mean of the NIS."""
COLORS = (style.VERMILLION, style.BLUE, style.GREEN, style.PURPLE, style.ORANGE, style.BLACK)
"""Colours of sensors."""
NAMES = ("innovations", "consistency", "deviations")


def figures_of(
    record: AssimilationRecord,
    space: Space,
    units: Mapping[str, str],
    reference: Reference = Reference(),  # noqa: B008 - a tuple
) -> dict[str, Figure]:
    """Draw the figures of a record and return them by name.

    Args:
        record: estimates and innovations.
        space: description of the state components.
        units: units of the measured values by name.
        reference: frame, centre, time scale and epoch of time zero, below the titles.
    """
    drawn = innovations(record, space, units), consistency(record, space), deviations(record, space)
    for figure in drawn:
        top = figure.axes[0]
        top.set_title(f"{top.get_title()}\n{reference.described()}".rstrip())
    return dict(zip(NAMES, drawn, strict=True))


def innovations(record: AssimilationRecord, space: Space, units: Mapping[str, str]) -> Figure:
    """Plot measurement minus prediction, each sensor in its colour, with a 3-sigma band."""
    time, unit = _time(record, space)
    figure = style.canvas(8, 1.2 + 1.9 * len(record.measured))
    panels = figure.subplots(len(record.measured), 1, sharex=True, squeeze=False)[:, 0]
    refused, sensors = record.outcome == "rejected", [*dict.fromkeys(record.sensor.tolist())]
    for k, (axes, name) in enumerate(zip(panels, record.measured, strict=True)):
        there = np.isfinite(record.innovation[:, k])
        t, value, wide = time[there], record.innovation[there, k], 3.0 * record.deviation[there, k]
        at, band_wide = style.parted(t, wide)
        axes.fill_between(at, -band_wide, band_wide, color=style.BAND, alpha=0.5, lw=0, label="±3σ")
        axes.axhline(0, color=style.BLACK, lw=0.6)
        taken = ~refused[there]
        limit = 2.0 * float(np.median(wide)) if len(t) else 1.0
        if taken.any():  # the first innovations, with the uncertainty of the start, would hide all others
            limit = max(limit, MARGIN * float(np.quantile(np.abs(value[taken]), MOST)))
        several = len(sensors) > 1
        for sensor, color in zip(sensors, cycle(COLORS), strict=False):
            own = taken & (record.sensor[there] == sensor)
            look = {"color": color, "ms": 3, "ls": "none", "label": sensor if several else "innovation"}
            axes.plot(t[own], value[own], ".", **look)
            for sign, mark in ((1, "^"), (-1, "v")):
                if (beyond := own & (sign * value > limit)).any():
                    at, look = np.full(beyond.sum(), sign * limit), {"ms": 4, "ls": "none"}
                    axes.plot(t[beyond], at, mark, color=color, label="beyond the axis", **look)
        for far, mark, label in (
            (np.abs(value) <= limit, "x", "rejected"),
            (value > limit, "^", "rejected, above the axis"),
            (value < -limit, "v", "rejected, below the axis"),
        ):
            if (own := ~taken & far).any():
                at = np.clip(value[own], -limit, limit)
                axes.plot(t[own], at, mark, color=style.BLACK, ms=5, ls="none", label=label)
        axes.set_ylim(-1.1 * limit, 1.1 * limit)
        axes.set_ylabel(f"{name} [{units[name]}]" if units.get(name) else name)
    style.legend_below(figure, *panels)
    panels[0].set_title(f"{space.name}: innovations")
    panels[-1].set_xlabel(f"time [{unit}]")
    return figure


def consistency(record: AssimilationRecord, space: Space) -> Figure:
    """Plot the NIS per measured value, as a moving mean over accepted readings, with its 95 % band."""
    time, unit = _time(record, space)
    figure = style.canvas(8, 4)
    axes = figure.subplots()
    taken = (record.outcome == "taken") & np.isfinite(record.nis)
    count = min(AVERAGED, max(1, int(taken.sum())))
    nis, dof = (np.convolve(part[taken], np.ones(count), "valid") for part in (record.nis, record.dof))
    if len(nis):
        limits = np.array([band(total, 1) for total in sorted({*dof})])
        where = np.searchsorted(sorted({*dof}), dof)
        t = time[taken][count - 1 :]
        t, low, high, mean = style.parted(t, *(limits[where].T / dof), nis / dof)
        axes.fill_between(t, low, high, color=style.BAND, alpha=0.5, lw=0, label="95 % band")
        axes.plot(t, mean, **style.MODEL, label=f"mean of {count} readings")
    axes.axhline(1, color=style.BLACK, lw=0.6)
    axes.set_ylabel("NIS / number of values")
    axes.set_xlabel(f"time [{unit}]")
    axes.set_title(f"{space.name}: consistency")
    style.legend_below(figure, axes)
    return figure


def deviations(record: AssimilationRecord, space: Space) -> Figure:
    """Plot the standard deviations of position and velocity, as roots of sums of squares over components."""
    time, unit = _time(record, space)
    figure = style.canvas(8, 5)
    panels = figure.subplots(2, 1, sharex=True)
    variance = np.diagonal(record.covariance, axis1=1, axis2=2)
    parts = variance[:, : space.dof], variance[:, space.dof :] / np.square(space.divisor)
    for axes, part, name in zip(panels, parts, style.NAMES, strict=True):
        axes.plot(*style.parted(time, np.sqrt(part.sum(1))), **(style.MODEL | {"lw": 1.2}))
        axes.set_ylabel(f"σ of {headed(space, name)}")
        style.logarithmic(axes, 0)
    panels[0].set_title(f"{space.name}: filter standard deviations")
    panels[-1].set_xlabel(f"time [{unit}]")
    return figure


def _time(record: AssimilationRecord, space: Space) -> tuple[Array, str]:
    """Return the times of a record, in hours for long time spans in seconds."""
    size, unit = style.plotted_time(float(record.time[-1] - record.time[0]), space.units.time)
    return record.time / size, unit
