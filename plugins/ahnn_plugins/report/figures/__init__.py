"""Figures of a report, from runs and their arrays; figures without data are omitted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator

from ahnn.systems import Molniya, MolniyaGravity
from ahnn_plugins.report.collection import Collection
from ahnn_plugins.report.drawing import Drawing
from ahnn_plugins.report.figures.accelerations import acceleration_drawing
from ahnn_plugins.report.figures.averages import average_drawings
from ahnn_plugins.report.figures.consistency import consistency_drawings
from ahnn_plugins.report.figures.energies import energy_drawings
from ahnn_plugins.report.figures.equations import system_of
from ahnn_plugins.report.figures.models import one_each, slots
from ahnn_plugins.report.figures.paths import path_drawings
from ahnn_plugins.report.figures.reading import kept
from ahnn_plugins.report.figures.scores import score_drawings
from ahnn_plugins.report.figures.states import state_drawings
from ahnn_plugins.report.figures.task import Task, make_task

__all__ = ["draw"]

FAMILIES: tuple[Callable[[Task], list[Drawing]], ...] = (
    path_drawings,
    energy_drawings,
    average_drawings,
    state_drawings,
    consistency_drawings,
)


def draw(collection: Collection) -> list[Drawing]:
    """Return the figures of a report, grouped by system, with unique names.

    Raises:
        UserError: the arrays of a run are damaged.
    """
    return list(_renamed(_drawings(collection)))


def _drawings(collection: Collection) -> Iterator[Drawing]:
    look = slots(collection)
    for system in collection.systems():
        entries = one_each(collection.of(system))
        yield from score_drawings(collection, system, look)
        runs = [run for entry in entries if (run := kept(entry, look[entry.model])) is not None]
        if runs:
            task = make_task(system, runs)
            for family in FAMILIES:
                yield from family(task)
    if any(isinstance(system_of(entry), Molniya | MolniyaGravity) for entry in collection.entries):
        yield acceleration_drawing()


def _renamed(drawings: Iterable[Drawing]) -> Iterator[Drawing]:
    """Yield drawings with unique names, since file names of systems may coincide."""
    seen: Counter[str] = Counter()
    for drawing in drawings:
        seen[drawing.name] += 1
        count = seen[drawing.name]
        yield drawing if count == 1 else drawing._replace(name=f"{drawing.name}_{count}")
