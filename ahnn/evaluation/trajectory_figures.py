"""Figures of predicted trajectories: errors, energy, and motion."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from torch import Tensor

from ahnn.evaluation import style
from ahnn.evaluation.case import Case
from ahnn.evaluation.open_loop import floors
from ahnn.evaluation.titles import title
from ahnn.labels import quantity
from ahnn.metrics import errors, moving_average

SMOOTHING = 240
"""Width of the moving average in samples (paper, appendix)."""


class Curve(NamedTuple):
    """Predictions (B, T, D) from the true or the fitted start, with their name and style."""

    states: Tensor
    name: str
    look: dict[str, Any]


def open_loop_figures(case: Case, arrays: dict[str, Tensor]) -> dict[str, Figure]:
    """Draw the figures of an open-loop evaluation, by name, errors first.

    Args:
        case: evaluated case.
        arrays: predictions (B, T, D) with the names of `open_loop`.
    """
    curves = list(_curves(case, arrays))
    figures = {"error": error(case, curves)}
    if case.fitted is None and (case.truth is not None or case.energy is not None):
        figures["energy"] = energy(case, curves)
    kinds = {2: ("path", path), 3: ("orbit", orbit)}
    name, draw = kinds.get(case.space.dof, ("phase_portrait", phase_portrait))
    if draw is not phase_portrait or bool(case.test.present.any()):
        figures[name] = draw(case, curves)
    return figures


def _curves(case: Case, arrays: dict[str, Tensor]) -> Iterator[Curve]:
    """Yield the prediction of the floor, if any, and that of the model."""
    floor = floors(case).get("true")
    if floor is not None:
        name = f"floor: {title(floor.who, case.label)}"
        yield Curve(arrays["floor_true_start"], name, style.FLOOR)
    states = arrays[f"{case.start}_start"]
    yield Curve(states.where(states.abs() < style.LOST, torch.nan), case.label, style.MODEL)


def error(case: Case, curves: list[Curve]) -> Figure:
    """Plot position and velocity errors of model and floor over time (thin), and moving averages (thick).

    Unmeasured velocities have no panel.
    """
    known = sum(bool(block.isfinite().any()) for block in case.test.states.chunk(2, dim=-1))
    figure = style.canvas(8, 3 * known)
    panels = figure.subplots(known, 1, sharex=True, squeeze=False)[:, 0]
    uneven = isinstance(case.dt, Tensor)
    axis = style.own_times(case) if uneven else style.time_axis(case)
    smooth = len(case.test.states[0]) > 2 * SMOOTHING
    for curve in curves:
        blocks = errors(curve.states, case.test.states).chunk(2, dim=-1)
        for axes, block, unit in zip(panels, blocks, (1.0, case.space.divisor), strict=False):
            squares = (block / unit).square().sum(-1)
            time, mean = in_time(axis.time, squares) if uneven else (axis.time, squares.nanmean(0))
            rms = mean[1:].sqrt()
            main = moving_average(rms, SMOOTHING) if smooth else rms
            axes.plot(time[1:], main, **curve.look, label=curve.name)
            if smooth:
                axes.plot(time[1:], rms, color=curve.look["color"], lw=0.6, alpha=0.45)
    for axes in panels:
        style.logarithmic(axes, 0)
    style.label_errors(case, panels)
    style.label_time(panels[-1], axis)
    style.legend_below(figure, panels[0])
    head = f"{case.space.name}: rms error over {_count(len(case.test.states))}, {case.start} start"
    panels[0].set_title(f"{head}\nthick: mean of the last {SMOOTHING} samples" if smooth else head)
    return figure


def in_time(times: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    """Return mean times and values (N,) of groups of B neighbours in time, for B unsynchronised trajectories.

    An incomplete group at the end is omitted.

    Args:
        times: (B, T) times.
        values: (B, T) values, NaN where missing.
    """
    there = ~values.isnan()
    time, order = times[there].sort()
    values, count = values[there][order], min(len(times), len(time))
    if not count:
        return time, values
    return time.unfold(0, count, count).mean(-1), values.unfold(0, count, count).mean(-1)


def energy(case: Case, curves: list[Curve]) -> Figure:
    """Plot the drift of the true energy, or else of the learned one, along the first trajectory.

    The upper panel shows the change, the lower panel its difference from the change along the data, which is
    zero if energy is conserved.
    """
    figure = style.canvas(8, 6)
    upper, lower = figure.subplots(2, 1, sharex=True)
    own, unit = style.own_times(case), case.space.units.energy
    axis = own._replace(time=own.time[0])
    hamiltonian = case.energy if case.truth is None else case.truth.energy
    assert hamiltonian is not None
    data = hamiltonian(case.test.states[0])
    upper.plot(axis.time, data - data[0], **style.TRUTH, label=style.reference(case))
    for curve in curves:
        change = hamiltonian(curve.states[0]) - data[0]
        change = change.where(change.isfinite(), torch.nan)
        upper.plot(axis.time, change, **curve.look, label=curve.name)
        error = (change - (data - data[0]))[1:].abs()
        lower.plot(axis.time[1:], error, **(curve.look | {"lw": 1.2}))
    style.logarithmic(lower, 0)
    upper.grid(alpha=0.3)
    upper.ticklabel_format(axis="y", scilimits=(-3, 4))
    which = "true" if case.truth is not None else "learned"
    upper.set_ylabel(f"change in {which} energy [{unit}]")
    lower.set_ylabel(f"energy error [{unit}]")
    style.label_time(lower, axis)
    style.legend_below(figure, upper)
    start = f"{float(data[0]):.6g}" + (f" {unit}" if unit != "1" else "")
    upper.set_title(f"{case.space.name}: energy along one unseen trajectory, initially {start}")
    return figure


def phase_portrait(case: Case, curves: list[Curve], count: int = 4) -> Figure:
    """Plot velocity against position for a few test trajectories, and the errors of both."""
    figure = style.canvas(10, 4.8)
    left, right = figure.subplots(1, 2)
    truth = _plane(case, case.test.states[:count])
    thick = curves[-1].look | {"lw": 3.0, "alpha": 0.7}
    for model, data in zip(_plane(case, curves[-1].states[:count]), truth, strict=True):
        left.plot(*model.T, **thick, label=curves[-1].name)
        left.plot(*data.T, **style.TRACK, label=style.reference(case))
    for curve in reversed(curves):
        _errors_in_plane(right, curve, _plane(case, curve.states[:count]) - truth)
    q, v = (style.state_labels(case)[i] for i in (0, case.space.dof))
    for axes, prefix in ((left, ""), (right, "error of ")):
        axes.set_xlabel(prefix + q)
        axes.set_ylabel(prefix + v)
        axes.grid(alpha=0.3)
        axes.locator_params(axis="x", nbins=6)
        axes.ticklabel_format(scilimits=(-3, 4))
    style.near(left, truth)
    left.set_title("phase portrait")
    right.set_title(f"prediction - {style.reference(case)}")
    style.legend_below(figure, left, right)
    figure.suptitle(f"{case.space.name}: {_count(len(truth))}, {case.start} start")
    return figure


def _plane(case: Case, states: Tensor) -> Tensor:
    """Return the first position and its velocity, (B, T, 2), NaN where they are not finite."""
    plane = torch.stack(
        (states[..., 0], states[..., case.space.dof] / case.space.scales[case.space.dof]), dim=-1
    )
    return plane.where(plane.isfinite(), torch.nan)


def _errors_in_plane(axes: Any, curve: Curve, off: Tensor) -> None:
    """Plot errors (B, T, 2), or a marker with a remark if they are too small to be visible."""
    low, high = torch.tensor(axes.dataLim.get_points(), dtype=torch.float64)
    size = off.abs().nan_to_num(0.0).flatten(0, 1).amax(0)
    if bool((size < 0.01 * (high - low)).all()):
        mark = {"color": curve.look["color"], "marker": "+", "ms": 9, "ls": "none", "mew": 1.5}
        axes.plot(0, 0, **mark, label=f"{curve.name} (smaller than its mark)")
        return
    for one in off:
        axes.plot(*one.T, **(curve.look | {"lw": 1.0}), label=curve.name)


def path(case: Case, curves: list[Curve]) -> Figure:
    """Plot the first test trajectory in the plane of its two positions, coloured by the model's error."""
    figure = style.canvas(7, 5.8)
    axes: Any = figure.subplots()
    truth, model = (x[0, :, :2].numpy() for x in (case.test.states, curves[-1].states))
    axes.plot(*truth.T, **style.TRACK, label=style.reference(case))
    _coloured(case, figure, axes, LineCollection, model, truth)
    axes.set_aspect("equal", adjustable="datalim")
    for name, text in zip("xy", style.state_labels(case), strict=False):
        getattr(axes, f"set_{name}label")(text)
    axes.grid(alpha=0.3)
    axes.set_title(f"{case.space.name}: {case.label} on one unseen trajectory, {case.start} start")
    axes.legend(loc="upper right")
    return figure


def orbit(case: Case, curves: list[Curve]) -> Figure:
    """Plot the first test orbit in space, coloured by the model's error, with the planet to scale."""
    figure = style.canvas(8, 6.5)
    axes: Any = figure.add_subplot(projection="3d", computed_zorder=False)
    truth, model = (x[0, :, :3].numpy() for x in (case.test.states, curves[-1].states))
    radius = getattr(case.truth, "r_eq", None)
    if radius:
        u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 37), np.linspace(0, np.pi, 19))
        sphere = (np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v))
        look = {"color": style.SKY, "alpha": 0.35, "linewidth": 0, "rasterized": True, "zorder": 1}
        axes.plot_surface(*(radius * s for s in sphere), **look)
    axes.plot(*truth.T, **style.TRACK, label=style.reference(case))
    _coloured(case, figure, axes, Line3DCollection, model, truth)
    axes.set_aspect("equal")
    for name, text in zip("xyz", style.state_labels(case), strict=False):
        getattr(axes, f"set_{name}label")(text, labelpad=8)
        getattr(axes, f"{name}axis").set_major_locator(MaxNLocator(4 if name == "z" else 3))
        axes.tick_params(axis=name, labelsize=8)
    axes.tick_params(axis="z", pad=6)
    axes.set_title(f"{case.space.name}: {case.label} on one unseen trajectory, {case.start} start")
    axes.legend(loc="upper left")
    return figure


def _coloured(case: Case, figure: Figure, axes: Any, kind: Any, model: Any, truth: Any) -> None:
    """Plot predicted positions (T, n) as a line coloured by their distance from the truth."""
    distance = np.linalg.norm(model - truth, axis=-1)[1:]
    there = np.isfinite(distance)
    segments = np.stack((model[:-1], model[1:]), axis=1)[there]
    distance = np.maximum(distance[there], np.finfo(float).tiny)
    if not len(distance):
        return
    high = float(distance.max())
    norm = LogNorm(max(float(np.quantile(distance, 0.02)), high * 1e-6), high)
    lines = kind(segments, cmap=style.ERRORS, norm=norm, lw=3.5, zorder=2)
    lines.set_array(distance)
    axes.add_collection(lines)
    bar = figure.colorbar(lines, ax=axes, shrink=0.75, pad=0.09 if case.space.dof == 3 else 0.02)
    bar.set_label(f"position error of {case.label} [{quantity(case.space, 'position')[1]}]")


def _count(trajectories: int) -> str:
    return f"{trajectories} unseen {'trajectory' if trajectories == 1 else 'trajectories'}"
