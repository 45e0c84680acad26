"""Pictures of predicted trajectories: phase portrait or orbit, energy and error over time."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from torch import Tensor

from ahnn.evaluation.case import Case
from ahnn.metrics import errors, moving_average

SMOOTHING = 240
"""Width of the moving average in samples (paper, appendix)."""

TRUTH = {"color": "black", "lw": 1.0, "ls": "--", "label": "truth"}


def open_loop_figures(case: Case, arrays: dict[str, Tensor]) -> dict[str, Figure]:
    """Return the figures of an open-loop evaluation under their names."""
    prediction = arrays["true_start"]
    portrait = orbit(case, prediction) if case.system.dof == 3 else phase_portrait(case, prediction)
    return {
        "orbit" if case.system.dof == 3 else "phase_portrait": portrait,
        "energy": energy(case, arrays),
        "error": error(case, arrays),
    }


def phase_portrait(case: Case, prediction: Tensor, count: int = 5) -> Figure:
    """Draw the first positions against their momenta for a few test trajectories."""
    figure, axes = _canvas()
    n = case.system.dof
    for b in range(min(count, len(prediction))):
        truth, model = case.test.states[b], prediction[b]
        label = case.label if b == 0 else None
        axes.plot(model[:, 0], model[:, n], color="tab:red", lw=1.6, alpha=0.8, label=label)
        axes.plot(truth[:, 0], truth[:, n], **{**TRUTH, "label": "truth" if b == 0 else None})
    q, p = case.system.components[0], case.system.components[n]
    axes.set_xlabel(f"{q} [{case.system.units.position}]")
    axes.set_ylabel(f"{p} / m [{case.system.units.velocity}]")
    axes.set_title(f"{case.system.name}: phase portrait of {min(count, len(prediction))} unseen trajectories")
    axes.legend(loc="upper right")
    return figure


def orbit(case: Case, prediction: Tensor) -> Figure:
    """Draw the first test orbit in space, the planet to scale if the system has one."""
    figure = Figure(figsize=(7, 6.5), layout="constrained")
    axes: Any = figure.add_subplot(projection="3d")
    truth, model = (np.asarray(states[0, :, :3]) for states in (case.test.states, prediction))
    radius = getattr(case.system, "r_eq", None)
    if radius:
        u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 37), np.linspace(0, np.pi, 19))
        sphere = (np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v))
        axes.plot_surface(*(radius * s for s in sphere), color="tab:blue", alpha=0.5, linewidth=0)
    axes.plot(*model.T, color="tab:red", lw=1.6, alpha=0.8, label=case.label)
    axes.plot(*truth.T, **TRUTH)
    axes.set_aspect("equal")
    for name in "xyz":
        getattr(axes, f"set_{name}label")(f"{name} [{case.system.units.position}]", labelpad=8)
        getattr(axes, f"{name}axis").set_major_locator(MaxNLocator(4))
        axes.tick_params(axis=name, labelsize=8)
    axes.tick_params(axis="z", pad=6)
    axes.set_title(f"{case.system.name}: one unseen orbit, inertial frame")
    axes.legend(loc="upper left")
    return figure


def energy(case: Case, arrays: dict[str, Tensor]) -> Figure:
    """Draw how far the true Hamiltonian strays along the first predicted trajectory, floor in grey."""
    figure, axes = _canvas()
    time, unit = _time_axis(case)
    start = case.system.energy(case.test.states[0, 0])
    for key, label, color in _curves(case):
        axes.plot(time, case.system.energy(arrays[key][0]) - start, color=color, label=label)
    axes.axhline(0, **TRUTH)
    axes.set_xlabel(f"time [{unit}]")
    axes.set_ylabel(f"energy - initial energy [{case.system.units.energy}]")
    value = f"{float(start):.6g} {case.system.units.energy}"
    axes.set_title(f"{case.system.name}: energy along one unseen trajectory of {value}")
    axes.legend(loc="best")
    return figure


def error(case: Case, arrays: dict[str, Tensor]) -> Figure:
    """Draw position and velocity error over time, thin, and its moving average, thick; floor in grey."""
    figure = Figure(figsize=(8, 6), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True)
    time, unit = _time_axis(case)
    for key, label, color in _curves(case):
        blocks = errors(arrays[key], case.test.states).chunk(2, dim=-1)
        blocks = blocks[0], blocks[1] / case.system.inertia
        for axes, block in zip(panels, blocks, strict=True):
            rms = block.square().sum(-1).nanmean(0).sqrt()
            axes.plot(time[1:], rms[1:], color=color, lw=0.6, alpha=0.5)
            axes.plot(time[1:], moving_average(rms[1:], SMOOTHING), color=color, lw=1.8, label=label)
    for axes, name in zip(panels, ("position", "velocity"), strict=True):
        axes.set_yscale("log")
        axes.set_ylabel(f"{name} error [{getattr(case.system.units, name)}]")
        axes.grid(alpha=0.3)
    panels[0].legend(loc="best", title=f"mean of last {SMOOTHING} samples")
    panels[0].set_title(f"{case.system.name}: rms error over {len(case.test.states)} unseen trajectories")
    panels[-1].set_xlabel(f"time [{unit}]")
    return figure


def _curves(case: Case) -> tuple[tuple[str, str, str], ...]:
    """Return array, label and colour of the floor and of the model."""
    floor = f"exact field, {case.integrator.name}"
    return ("floor_true_start", floor, "tab:gray"), ("true_start", case.label, "tab:red")


def _canvas() -> tuple[Figure, Any]:
    figure = Figure(figsize=(7, 5), layout="constrained")
    return figure, figure.add_subplot()


def _time_axis(case: Case) -> tuple[Tensor, str]:
    """Return the sampling times, shape (T,), in hours where the system's unit is s and the arc is long."""
    time = torch.arange(case.test.states.shape[1], dtype=torch.float64) * case.test.dt
    unit = case.system.units.time
    return (time / 3600, "h") if unit == "s" and time[-1] > 7200 else (time, unit)
