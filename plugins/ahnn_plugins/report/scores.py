"""Scores of a system's runs by model: samples over seeds, with floors."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from ahnn.evaluation.case import Row, Start, Who
from ahnn.evaluation.titles import MODEL
from ahnn.labels import quantity
from ahnn_plugins.report.collection import Collection, Entry
from ahnn_plugins.report.paper import MODELS, PaperCell, Printed, printed
from ahnn_plugins.report.score_samples import Sample

QUANTITIES = ("position", "velocity", "energy")
FILTERS = ("ukf_tuned", "ukf")
"""Estimators used for the paper's rows with the filter; the paper uses a tuned one."""


class Measure(NamedTuple):
    """Definition of a score.

    Attributes:
        model: name in tables.
        quantity: `position`, `velocity` or `energy`.
        start: start of the prediction.
        filtered: whether the score is with the filter.
    """

    model: str
    quantity: str = "position"
    start: Start = "true"
    filtered: bool = False


class Board(NamedTuple):
    """Runs of a system by model; runs of the paper's recipe have the paper's names, in capitals.

    Attributes:
        system: system name.
        groups: runs grouped by model, first the models of the paper in its order, then all others.
        estimator: estimator of filtered rows, or None.
    """

    system: str
    groups: dict[str, list[Entry]]
    estimator: str | None

    @property
    def entries(self) -> list[Entry]:
        """All runs."""
        return [entry for group in self.groups.values() for entry in group]

    def sample(self, measure: Measure) -> Sample:
        """Return a score over the runs that contain it."""
        return self.sample_of(self.groups.get(measure.model, []), measure)

    def sample_of(self, entries: list[Entry], measure: Measure) -> Sample:
        """Return a score over given runs, of any model."""
        if measure.filtered and self.estimator is None:
            return Sample(())
        who = Who(MODEL, measure.start, self.estimator if measure.filtered else None)
        return sample(entries, who, measure.quantity)

    def floor(self, measure: Measure) -> Sample:
        """Return the floor of a measure, over all runs that contain it."""
        if measure.filtered and self.estimator is None:
            return Sample(())
        found = (floor_of(e, measure.start, measure.filtered, self.estimator) for e in self.entries)
        values = (getattr(row.scores, measure.quantity) for row in found if row is not None)
        return measured(values)

    def printed(self, measure: Measure) -> Printed | None:
        """Return the paper's number for a measure; None if it is missing or in a different unit."""
        found = printed().get(
            PaperCell(self.system, measure.model, measure.filtered, measure.start, measure.quantity)
        )
        units = {quantity(entry.results.space, measure.quantity)[1] for entry in self.entries}
        return found if found is not None and units <= {found.unit} else None


def board(collection: Collection, system: str) -> Board:
    """Build the score board of a system."""
    groups: dict[str, list[Entry]] = {}
    for entry in collection.of(system):
        groups.setdefault(entry.model, []).append(entry)
    order = [*(m for m in MODELS if m in groups), *(m for m in groups if m not in MODELS)]
    return Board(system, {model: groups[model] for model in order}, estimator(collection.of(system)))


def estimator(entries: Iterable[Entry]) -> str | None:
    """Return the estimator of the rows with a filter: one common to all runs, preferably tuned."""
    named = [{r.who.estimator for r in e.results.rows if r.who.process == MODEL} - {None} for e in entries]
    there = [names for names in named if names]
    if not there:
        return None
    shared = set.intersection(*there) or set.union(*there)
    return next((name for name in FILTERS if name in shared), min(name for name in shared if name))


def plain_filter(entries: Iterable[Entry]) -> str:
    """Return the filter for figures: the plain one of the paper, or the first available."""
    names = dict.fromkeys(row.who.estimator for entry in entries for row in entry.results.rows)
    plain = [name for name in names if name and "_" not in name]
    return FILTERS[-1] if FILTERS[-1] in plain or not plain else plain[0]


def sample(entries: Iterable[Entry], who: Who, quantity: str) -> Sample:
    """Return a score of one row over the runs that contain it."""
    rows = (entry.results.row(who) for entry in entries)
    return measured(getattr(row.scores, quantity) for row in rows if row is not None)


def measured(values: Iterable[float | None]) -> Sample:
    """Return the sample without None or NaN, which mark unmeasured quantities; inf marks diverged runs."""
    return Sample(tuple(value for value in values if value is not None and not math.isnan(value)))


def floor_of(entry: Entry, start: str, filtered: bool, estimator: str | None) -> Row | None:
    """Return the floor from a start; for a filter without its own floor, the floor of its untuned form."""
    wanted = [estimator, (estimator or "").split("_")[0]] if filtered else [None]
    for name in wanted:
        for row in entry.results.rows:
            if row.who.floor and (row.who.start, row.who.estimator, row.who.span) == (start, name, "whole"):
                return row
    return None
