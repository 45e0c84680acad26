"""RMSE of every model and of each of its seeds, with the floor and the paper's value."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from statistics import fmean
from typing import Literal, NamedTuple, get_args

import torch

from ahnn.evaluation.score_table import about_fitted
from ahnn.evaluation.style import LOST
from ahnn.evaluation.titles import estimator_title
from ahnn_plugins.report.collection import Collection, Entry
from ahnn_plugins.report.drawing import Drawing, Panel, Role, Series
from ahnn_plugins.report.figures.models import one_each, ordered
from ahnn_plugins.report.figures.reading import STARTS
from ahnn_plugins.report.figures.task import file_name
from ahnn_plugins.report.paper import printed_value
from ahnn_plugins.report.scores import plain_filter

Quantity = Literal["position", "velocity", "energy"]

BESIDE = 0.17
"""Horizontal offset, to either side, of scores without and with a filter, if there are both."""
SEEDS = 0.06
"""Horizontal offset of the seeds from the dot of their model, to either side."""
FAR = 100.0
"""Ratio of scores to a floor above which the floor is stated, not drawn: scores would look like a line."""
SIDES = "Left: without measurements; right: with the filter. "
SPREAD = "Small dots: the seeds; large dots: their arithmetic mean, as in the tables."
TABLES = "The tables give mean ± standard deviation over the seeds. "
"""This interval may reach below zero, which a log axis cannot show, so the seeds are drawn instead."""
MEANING = "RMSE: mean over test trajectories of the rms vector norm; floor: score of the exact equations."


class Dot(NamedTuple):
    """Scores of the seeds at an axis position."""

    place: float
    values: tuple[float, ...]


def score_drawings(collection: Collection, system: str, slots: dict[str, int]) -> list[Drawing]:
    """Plot the scores from every start, and over the loss window if it varies."""
    entries = one_each(collection.of(system))
    models = ordered(list(dict.fromkeys(entry.model for entry in entries)))
    groups = [[e for e in entries if e.model == model] for model in models]
    found = [_of_start(system, models, groups, start, slots) for start in STARTS]
    return [drawing for drawing in (*found, _ablation(system, entries, slots)) if drawing is not None]


def _of_start(
    system: str, models: list[str], groups: list[list[Entry]], start: str, slots: dict[str, int]
) -> Drawing | None:
    panels = []
    beside = _beside(groups, (start,))
    for quantity in get_args(Quantity):
        series: list[Series] = []
        for i, (model, runs) in enumerate(zip(models, groups, strict=True)):
            series += _of_model(runs, start, quantity, (i, beside), slots[model])
        paper = [_printed(system, m, start, quantity, (i, beside)) for i, m in enumerate(models)]
        series += _dots("paper", [dot for several in paper for dot in several], "paper")
        if _has_model(series):
            label = f"{quantity} RMSE [{_unit(groups[0][0], quantity)}]"
            panels.append(_near(Panel(_merged(series), "", label, log=True, ticks=tuple(models))))
    if not panels:
        return None
    title = f"{system}: RMSE of the models, {start} start"
    rows = (row for runs in groups for run in runs for row in run.results.rows if row.who.start == start)
    about = about_fitted(rows)
    caption = f"{SIDES if beside else ''}{f'{about[0].upper()}{about[1:]} ' if about else ''}"
    return _drawing(f"{file_name(system)}_rmse_{start}", title, caption, panels)


def _beside(groups: Iterable[list[Entry]], starts: Sequence[str]) -> float:
    """Return the offset of scores with and without a filter; 0 if no run has a filter."""
    rows = (row.who for runs in groups for run in runs for row in run.results.rows)
    return BESIDE * any(who.estimator is not None and who.start in starts for who in rows)


def _near(panel: Panel) -> Panel:
    """Return a panel in which floors far below the scores are stated instead of drawn."""
    scored = [s.y for s in panel.series if s.role != "floor"]
    lowest, kept, below = float(torch.cat(scored).min()) / FAR, [], list[float]()
    for series in panel.series:
        far = (series.y < lowest) & (series.role == "floor")
        below += series.y[far].tolist()
        series = series._replace(x=series.x[~far], y=series.y[~far])
        kept += [series] if len(series.y) else []
    if not below:
        return panel
    limits = dict.fromkeys(f"{value:.2g}" for value in (min(below), max(below)))
    return panel._replace(series=tuple(kept), note=f"floor: {' to '.join(limits)}, below the axis")


def _of_model(
    runs: list[Entry], start: str, quantity: Quantity, at: tuple[int, float], slot: int
) -> list[Series]:
    """Return a model's dots at an axis position, with an offset between scores without and with a filter."""
    model, found, own = runs[0].model, [], plain_filter(runs)
    place, beside = at
    kinds: tuple[tuple[str | None, str, Role, Role, float], ...] = (
        (None, "", "model", "floor", -beside),
        (own, f" + {estimator_title(own)}", "filter", "floor", beside),
    )
    for estimator, suffix, role, floor_role, offset in kinds:
        scores = _scores(runs, start, quantity, estimator, floor=False)
        floors = _scores(runs, start, quantity, estimator, floor=True)
        found += _dots(f"{model}{suffix}", [Dot(place + offset, scores)], role, slot)
        found += _dots("floor", [Dot(place + offset, floors[:1])], floor_role)
    return found


def _scores(
    runs: Sequence[Entry], start: str, quantity: Quantity, estimator: str | None, *, floor: bool
) -> tuple[float, ...]:
    """Return the scores over the full span, one per run that has them."""
    found = []
    for run in runs:
        for row in run.results.rows:
            who = row.who
            if (who.start, who.estimator, who.floor, who.span) == (start, estimator, floor, "whole"):
                value = getattr(row.scores, quantity)
                found += [] if value is None else [float(value)]
                break
    return tuple(found)


def _printed(system: str, model: str, start: str, quantity: Quantity, at: tuple[int, float]) -> list[Dot]:
    place, beside = at
    both = ((False, -beside), (True, beside)) if beside else ((False, 0.0),)
    values = (
        (printed_value(system, model, start, quantity, ukf=ukf), place + offset) for ukf, offset in both
    )
    return [Dot(where, (value,)) for value, where in values if value is not None]


def _dots(label: str, dots: Sequence[Dot], role: Role, slot: int = 0) -> list[Series]:
    """Return one series of arithmetic means and one of seeds, without values that a log axis cannot show."""
    means, seeds = [], []
    for dot in dots:
        values = [v for v in dot.values if 0 <= v < LOST]
        means += [(dot.place, fmean(values))] if any(values) else []
        values = [v for v in values if v > 0]
        sides = (dot.place + SEEDS * (1 if i % 2 else -1) for i in range(len(values)))
        seeds += zip(sides, values, strict=True) if len(values) > 1 else []
    both: tuple[tuple[Role, list[tuple[float, float]]], ...] = ((role, means), ("seed", seeds))
    return [
        Series(label, *torch.tensor(rows, dtype=torch.float64).unbind(-1), role=each, slot=slot)
        for each, rows in both
        if rows
    ]


def _merged(series: Sequence[Series]) -> tuple[Series, ...]:
    """Return series, merged if label and role agree; floors and values of the paper are last."""
    found: dict[tuple[str, Role], Series] = {}
    for each in series:
        key = each.label, each.role
        old = found.get(key, each._replace(x=each.x[:0], y=each.y[:0]))
        found[key] = old._replace(x=torch.cat((old.x, each.x)), y=torch.cat((old.y, each.y)))
    return tuple(sorted(found.values(), key=lambda each: each.role in ("floor", "paper")))


def _ablation(system: str, entries: Sequence[Entry], slots: dict[str, int]) -> Drawing | None:
    """Return scores over the window W of the loss, for Hamiltonian models with equal assumptions."""
    groups: dict[int, list[Entry]] = {}
    assumes = next((e.results.assumes for e in entries if "Hamiltonian" in e.results.assumes), None)
    for entry in entries:
        window = entry.results.training.get("window")
        if entry.results.assumes == assumes and isinstance(window, int):
            groups.setdefault(window, []).append(entry)
    windows = sorted(groups)
    if len(windows) < 2:
        return None
    rows = [
        [e for e in groups[window] if e.model == model]
        for window in windows
        for model in dict.fromkeys(e.model for e in groups[window])
    ]
    places = [windows.index(row[0].results.training["window"]) for row in rows]
    ticks = tuple(f"W = {window}" for window in windows)
    panels, beside = [], _beside(rows, STARTS)
    for start, quantity in ((start, quantity) for start in STARTS for quantity in get_args(Quantity)):
        several = (
            _of_model(row, start, quantity, (p, beside), slots[row[0].model])
            for row, p in zip(rows, places, strict=True)
        )
        series = _merged([each for found in several for each in found])
        label = f"{quantity} [{_unit(rows[0][0], quantity)}], {start}"
        panels += [_near(Panel(series, "", label, log=True, ticks=ticks))] if _has_model(series) else []
    caption = f"Models with the same assumptions, {assumes}. {SIDES if beside else ''}"
    title = f"{system}: RMSE over the window W of the loss"
    return _drawing(f"{file_name(system)}_windows", title, caption, panels)


def _drawing(name: str, title: str, caption: str, panels: Sequence[Panel]) -> Drawing:
    """Return the drawing, which explains the dots of seeds if there are any."""
    several = any(series.role == "seed" for panel in panels for series in panel.series)
    caption = f"{caption}{TABLES if several else ''}{MEANING}"
    return Drawing(name, title, caption, tuple(panels), "dots", SPREAD if several else "")


def _has_model(series: Iterable[Series]) -> bool:
    return any(each.role == "model" for each in series)


def _unit(entry: Entry, quantity: Quantity) -> str:
    return getattr(entry.results.space.units, quantity)
