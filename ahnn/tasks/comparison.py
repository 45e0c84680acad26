"""Table of own and published scores of a task, 80 characters wide."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from statistics import median

from ahnn.tasks.definition import FieldTask

WIDTH = 80
OWN = ("score", "seconds", "floor")
"""Names of saved training information; all other entries are further scores."""
Scores = Mapping[str, Sequence[Mapping[str, float]]]
"""Saved results of the draws, by model."""


def table(name: str, task: FieldTask, scores: Scores) -> str:
    """Format one line per model: median and range over the draws, and the best published score.

    Args:
        name: name of the task.
        task: definition of the task.
        scores: `score` and `seconds` of each draw, and `floor` or other scores if available.
    """
    floors = sorted({one["floor"] for found in scores.values() for one in found if "floor" in one})
    known = ", ".join(f"{key} {value:.2g}" for key, value in task.published.items()) or "plots only"
    if task.floor is not None:
        known += f"; floor {task.floor:.2g}"
    elif floors:
        known += f"; floor {median(floors):.2g} ({spread(floors)})"
    unit, of = reference(task, floors)
    lines = [*textwrap.wrap(f"{name}: {task.title}", WIDTH), f"published: {known}"]
    lines.append(f"  {'model':<18}{'median':>10}{'range':>22}{'draws':>7}{'seconds':>9}  {of}".rstrip())
    for model, found in scores.items():
        values = [one["score"] for one in found]
        middle, seconds = median(values), median(one["seconds"] for one in found)
        ratio = f"{middle / unit:.2g}".rjust(len(of)) if unit else ""
        row = f"  {model:<18}{middle:>10.2g}{spread(values):>22}{len(values):>7}{seconds:>9.0f}  {ratio}"
        lines.append(row.rstrip())
        for other in [key for key in found[0] if key not in OWN]:
            further = [one[other] for one in found]
            lines.append(f"  {'- ' + other:<18}{median(further):>10.2g}{spread(further):>22}")
    if not scores:
        lines.append("  no training run is finished")
    lines += textwrap.wrap(verdict(task, scores), WIDTH)
    note = f"score: {task.quantity}. Differs: {task.differs}. Source: {task.source}."
    return "\n".join([*lines, *textwrap.wrap(note, WIDTH)])


def reference(task: FieldTask, floors: Sequence[float]) -> tuple[float, str]:
    """Return the reference score, 0 if there is none, and its column header."""
    if task.published:
        best = min(task.published, key=lambda key: task.published[key])
        return task.published[best], f"of {best}'s"
    floor = task.floor if task.floor is not None or not floors else median(floors)
    return (floor, "of floor") if floor else (0.0, "")


def spread(values: Sequence[float]) -> str:
    """Format the range of numbers."""
    return f"{min(values):.2g} to {max(values):.2g}"


def verdict(task: FieldTask, scores: Scores) -> str:
    """Return the number of draws in which each model beats the best published score; "" without one."""
    if not (task.published and scores):
        return ""
    unit, of = reference(task, [])
    parts = [
        f"{model} in {sum(one['score'] < unit for one in found)} of {len(found)} draws"
        for model, found in scores.items()
    ]
    return f"verdict: better than {of.removeprefix('of ')[:-2]}: {', '.join(parts)}."
