"""Predicted trajectories of all models and the truth: orbits in space, paths in a plane, phase portraits."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.labels import components
from ahnn_plugins.report.drawing import Drawing, Panel, Series
from ahnn_plugins.report.figures.curves import cut, path
from ahnn_plugins.report.figures.reading import Kept, velocities
from ahnn_plugins.report.figures.task import Task

CUT = "A prediction is drawn until it is far from the truth."


def path_drawings(task: Task) -> list[Drawing]:
    """Return the figure of the first test trajectory (paper, figures 1 and 5a)."""
    if not task.lead.start or not bool(task.lead.path.isfinite().all(-1).any()):
        return []
    draw = {2: plane, 3: orbits}.get(task.lead.space.dof, phase_portrait)
    return [draw(task)]


def orbits(task: Task) -> Drawing:
    """Draw orbits in space, with the planet to scale if its radius is known."""
    lead = task.lead
    x, y, z = components(lead.space)[:3]
    radius = float(getattr(lead.system, "r_eq", 0.0))
    series = [path(lead.known, lead.path[:, :3], role="track", hover=_hover(lead, lead.path[:, :3], radius))]
    for run in task.drawn:
        points = cut(run.first[run.start][:, :3], run.path[:, :3])
        hover = _hover(run, points, radius, run.path[:, :3])
        series.append(path(run.entry.model, points, slot=run.slot, hover=hover))
    panel = Panel(_behind(series), x, y, z, equal=True, radius=radius)
    caption = f"The first test orbit, {lead.start} start, without measurements. {CUT} {task.one_run_each()}"
    return task.drawing("orbits", "orbits (as in figure 1 of the paper)", caption.strip(), [panel], "orbit")


def plane(task: Task) -> Drawing:
    """Draw the two positions of the first trajectory."""
    columns = slice(0, 2)
    return _flat(task, "path", "path", columns)


def phase_portrait(task: Task) -> Drawing:
    """Plot velocity against position."""
    dof = task.lead.space.dof
    paper = " (as in figure 5a of the paper)" if task.system == "mass_spring" else ""
    title = f"phase portrait{paper}"
    return _flat(task, "phase_portrait", title, slice(0, 2 * dof, dof))


def _flat(task: Task, name: str, title: str, columns: slice) -> Drawing:
    lead, inertia = task.lead, task.lead.space.divisor
    x, y = components(lead.space)[columns]
    truth = velocities(lead.path, inertia)[:, columns]
    series = [path(lead.known, truth, role="track", hover={_time(lead): lead.time})]
    for run in task.drawn:
        points = cut(velocities(run.first[run.start], inertia)[:, columns], truth)
        series.append(path(run.entry.model, points, slot=run.slot, hover={_time(run): run.time}))
    caption = f"The first test trajectory, {lead.start} start, without measurements. {CUT} "
    panel = Panel(_behind(series), x, y, equal=columns.step is None)
    return task.drawing(name, title, (caption + task.one_run_each()).strip(), [panel])


def _behind(series: list[Series]) -> tuple[Series, ...]:
    """Return series with the truth last, so that its thin line is on top."""
    return (*series[1:], series[0])


def _hover(run: Kept, points: Tensor, radius: float, truth: Tensor | None = None) -> dict[str, Tensor]:
    """Return the tooltip values of positions (T, 3): time, altitude or distance, and error."""
    unit = run.space.units.position
    distance = points.norm(dim=-1)
    where = {f"altitude [{unit}]": distance - radius} if radius else {f"distance [{unit}]": distance}
    error = {} if truth is None else {f"error [{unit}]": torch.linalg.vector_norm(points - truth, dim=-1)}
    return {_time(run): run.time, **where, **error}


def _time(run: Kept) -> str:
    return f"time [{run.unit}]"
