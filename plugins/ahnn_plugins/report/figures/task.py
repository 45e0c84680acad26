"""Runs of one system compared in a figure, all tested on the same trajectories."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn_plugins.report.drawing import Drawing, Kind, Panel
from ahnn_plugins.report.figures.curves import Band
from ahnn_plugins.report.figures.models import ordered
from ahnn_plugins.report.figures.reading import Kept


class Task(NamedTuple):
    """The runs of a system, by model in legend order, and notes for captions.

    Attributes:
        system: system name.
        models: the runs of each model, one per seed.
        note: omitted runs, with reasons.
    """

    system: str
    models: dict[str, list[Kept]]
    note: str = ""

    @property
    def lead(self) -> Kept:
        """Representative run for common properties: times, units and truth."""
        return next(iter(self.models.values()))[0]

    @property
    def drawn(self) -> list[Kept]:
        """First run of each model, used for trajectories."""
        return [runs[0] for runs in self.models.values()]

    def drawing(
        self,
        name: str,
        title: str,
        caption: str,
        panels: Iterable[Panel],
        kind: Kind = "lines",
        spread: str = "",
    ) -> Drawing:
        """Build a figure of this system, with a portable file name."""
        words = (caption, self.note)
        return Drawing(
            f"{file_name(self.system)}_{name}",
            f"{self.system}: {title}",
            " ".join(word for word in words if word),
            tuple(panels),
            kind,
            spread,
        )

    def one_run_each(self) -> str:
        """Return a sentence on the runs shown as trajectories."""
        several = any(len(runs) > 1 for runs in self.models.values())
        return f"Runs: {', '.join(k.entry.folder.name for k in self.drawn)}." if several else ""

    def spread(self) -> str:
        """Return a sentence on the meaning of lines and bands for several seeds."""
        most = max(len(runs) for runs in self.models.values())
        return f"Lines: means over up to {most} seeds; bands: their range." if most > 1 else ""


def make_task(system: str, runs: list[Kept]) -> Task:
    """Select the runs of a system with the most common test data."""
    votes = [sum(_same_test(run, other) for other in runs) for run in runs]
    chosen = runs[votes.index(max(votes))]
    same = [run for run in runs if _same_test(run, chosen)]
    others = [run.entry.folder.name for run in runs if run not in same]
    names = ordered(list(dict.fromkeys(run.entry.model for run in same)))
    note = f"Omitted, since their test trajectories differ: {', '.join(others)}." if others else ""
    models = {m: sorted((run for run in same if run.entry.model == m), key=_seed) for m in names}
    return Task(system, models, note)


def _seed(run: Kept) -> float:
    """Return the seed of a run as a sort key; unknown seeds come first."""
    seed = run.entry.seed
    return seed if isinstance(seed, int | float) else -1.0


def _same_test(one: Kept, other: Kept) -> bool:
    a, b = (run.path.nan_to_num() for run in (one, other))
    return one.members == other.members and one.unit == other.unit and torch.equal(a, b)


def over_seeds(values: Iterable[Tensor]) -> tuple[Tensor, Band | None]:
    """Return the mean of the values (T,) of several seeds and their range; no range for a single seed."""
    stack = torch.stack(list(values))
    stack = stack.masked_fill(~stack.isfinite(), torch.nan)
    mean = stack.mean(0)
    return mean, None if len(stack) == 1 else (stack.amin(0), stack.amax(0))


def file_name(name: str) -> str:
    """Return a portable file name."""
    return re.sub(r"[^\w-]+", "_", name, flags=re.ASCII).strip("_")[:60] or "system"


def time_label(run: Kept) -> str:
    """Return the label of an axis of time."""
    return "sample" if run.unit == "samples" else f"time [{run.unit}]"
