"""The runs of one system that a figure compares: all were tested on the same trajectories."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.labels import components
from ahnn_plugins.report.drawing import Drawing, Kind, Panel
from ahnn_plugins.report.figures.curves import Band
from ahnn_plugins.report.figures.models import ordered
from ahnn_plugins.report.figures.reading import Kept


class Task(NamedTuple):
    """The runs of a system, by model in the order of legends, and what captions say of all of them.

    Attributes:
        system: its name.
        models: the runs of each model, one for each seed.
        note: which runs are left out, and why.
    """

    system: str
    models: dict[str, list[Kept]]
    note: str = ""

    @property
    def lead(self) -> Kept:
        """A run that speaks for all of them where they agree: on times, units and the truth."""
        return next(iter(self.models.values()))[0]

    @property
    def drawn(self) -> list[Kept]:
        """The first run of each model, whose trajectories are drawn."""
        return [runs[0] for runs in self.models.values()]

    def drawing(
        self, name: str, title: str, caption: str, panels: Iterable[Panel], kind: Kind = "lines"
    ) -> Drawing:
        """Return a figure of this system; the name of its file is one on every disk."""
        words = (caption, self.note)
        return Drawing(
            f"{file_name(self.system)}_{name}",
            f"{self.system}: {title}",
            " ".join(word for word in words if word),
            tuple(panels),
            kind,
        )

    def one_run_each(self) -> str:
        """Return a sentence on which runs trajectories are of."""
        several = any(len(runs) > 1 for runs in self.models.values())
        return f"Runs: {', '.join(k.entry.folder.name for k in self.drawn)}." if several else ""

    def spread(self) -> str:
        """Return a sentence on what lines and bands are of several seeds."""
        most = max(len(runs) for runs in self.models.values())
        return f"Lines are means over up to {most} seeds, bands their range." if most > 1 else ""


def make_task(system: str, runs: list[Kept]) -> Task:
    """Return the runs of a system that were tested on what most of them were tested on."""
    votes = [sum(_same_test(run, other) for other in runs) for run in runs]
    chosen = runs[votes.index(max(votes))]
    same = [run for run in runs if _same_test(run, chosen)]
    others = [run.entry.folder.name for run in runs if run not in same]
    names = ordered(list(dict.fromkeys(run.entry.model for run in same)))
    note = f"Left out, since their test trajectories are others: {', '.join(others)}." if others else ""
    models = {m: sorted((run for run in same if run.entry.model == m), key=_seed) for m in names}
    return Task(system, models, note)


def _seed(run: Kept) -> float:
    """Return the seed of a training, first of all where it is not known."""
    seed = run.entry.seed
    return seed if isinstance(seed, int | float) else -1.0


def _same_test(one: Kept, other: Kept) -> bool:
    a, b = (run.path.nan_to_num() for run in (one, other))
    return one.members == other.members and one.unit == other.unit and torch.equal(a, b)


def over_seeds(values: Iterable[Tensor]) -> tuple[Tensor, Band | None]:
    """Return the mean of the values (T,) of several seeds and their range; one seed alone has none."""
    stack = torch.stack(list(values))
    stack = stack.masked_fill(~stack.isfinite(), torch.nan)
    mean = stack.mean(0)
    return mean, None if len(stack) == 1 else (stack.amin(0), stack.amax(0))


def file_name(name: str) -> str:
    """Return a name that is a plain file on any disk."""
    return re.sub(r"[^\w-]+", "_", name, flags=re.ASCII).strip("_")[:60] or "system"


def state_labels(run: Kept) -> list[str]:
    """Return the names of the state components with their units, momenta as velocities where they are."""
    return components(run.space)


def time_label(run: Kept) -> str:
    """Return the label of an axis of time."""
    return "sample" if run.unit == "samples" else f"time [{run.unit}]"


def title_of(start: str) -> str:
    """Return what a start is called in titles."""
    return f"{start} start"
