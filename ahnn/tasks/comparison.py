"""Scores of a task beside those that were published, as a text of 80 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from statistics import median

from ahnn.tasks.definition import FieldTask

WIDTH = 80


def table(name: str, task: FieldTask, scores: Mapping[str, Sequence[Mapping[str, float]]]) -> str:
    """Return a line for each model: median and range over the draws, beside the best published score.

    Args:
        name: of the task.
        task: what it is.
        scores: `score` and `seconds` of each draw, by model.
    """
    best = min(task.published, key=lambda key: task.published[key])
    known = ", ".join(f"{key} {value:.2g}" for key, value in task.published.items())
    if task.floor is not None:
        known += f"; floor {task.floor:.2g}"
    lines = [*textwrap.wrap(f"{name}: {task.title}", WIDTH), f"published: {known}"]
    lines.append(f"  {'model':<18}{'median':>10}{'range':>22}{'draws':>7}{'seconds':>9}  of {best}'s")
    for model, found in scores.items():
        values = [one["score"] for one in found]
        middle = median(values)
        spread, draws = f"{min(values):.2g} to {max(values):.2g}", len(values)
        seconds = median(one["seconds"] for one in found)
        ratio = f"{middle / task.published[best]:.2g}".rjust(len(best) + 5)
        lines.append(f"  {model:<18}{middle:>10.2g}{spread:>22}{draws:>7}{seconds:>9.0f}  {ratio}")
    if not scores:
        lines.append("  no training is finished")
    note = f"score: {task.quantity}. Differs: {task.differs}. Source: {task.source}."
    return "\n".join([*lines, *textwrap.wrap(note, WIDTH)])
