"""Energy along predicted trajectories, by the true Hamiltonian."""

from __future__ import annotations

from ahnn_plugins.report.drawing import Drawing, Panel, Role, Series
from ahnn_plugins.report.figures.curves import curve
from ahnn_plugins.report.figures.task import Task, time_label

FIGURES = {"mass_spring": " (as in figure 5b of the paper)", "molniya": " (as in figure 7 of the paper)"}


def energy_drawings(task: Task) -> list[Drawing]:
    """Plot energy and energy error of the first test trajectory, for known systems."""
    lead, system = task.lead, task.lead.system
    if system is None or not lead.start or lead.known == "measurements":
        return []
    truth = system.energy(lead.path)
    floor = lead.first.get(f"floor_{lead.start}")
    predictions = [(run.entry.model, run.first[run.start], run.slot) for run in task.drawn]
    predictions += [] if floor is None else [("floor", floor, None)]
    above, below = [], []
    for label, states, number in predictions:
        role: Role = "floor" if number is None else "model"
        slot = number or 0
        energy = system.energy(states)
        above.append(curve(label, lead.time, energy, role=role, slot=slot))
        off = (energy - truth).abs()
        below.append(curve(label, lead.time, off, role=role, slot=slot, log=True))
    above.append(curve(lead.known, lead.time, truth, role="truth"))
    return [_drawing(task, above, below)]


def _drawing(task: Task, above: list[Series], below: list[Series]) -> Drawing:
    lead = task.lead
    unit, time = lead.space.units.energy, time_label(lead)
    caption = (
        f"True Hamiltonian along the predictions of the first test trajectory, {lead.start} start, without "
        f"measurements; below, its error. {task.one_run_each()}"
    )
    panels = [
        Panel(tuple(above), time, f"energy [{unit}]"),
        Panel(tuple(below), time, f"energy error [{unit}]", log=True),
    ]
    title = f"energy over time{FIGURES.get(task.system, '')}"
    return task.drawing("energy", title, caption.strip(), panels)
