"""RMSE of every model with its spread over seeds, beside the floor and what the paper prints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, get_args

import torch

from ahnn_plugins.report.collection import Collection, Entry
from ahnn_plugins.report.drawing import Drawing, Panel, Role, Series
from ahnn_plugins.report.figures.models import one_each, ordered
from ahnn_plugins.report.figures.published import Quantity, published
from ahnn_plugins.report.figures.reading import STARTS
from ahnn_plugins.report.figures.task import file_name

BESIDE = 0.17
"""How far left of its place a model stands, and how far right of it the same model with a filter."""
DOTS = "Dots are means over seeds, lines their range. "


class Dot(NamedTuple):
    """A score at a place of an axis, with the range of several seeds."""

    place: float
    values: tuple[float, ...]


def score_drawings(collection: Collection, system: str, slots: dict[str, int]) -> list[Drawing]:
    """Return the scores from every start, and those over the window of the loss where it varies."""
    entries = one_each(collection.of(system))
    models = ordered(list(dict.fromkeys(entry.model for entry in entries)))
    groups = [[e for e in entries if e.model == model] for model in models]
    found = [_of_start(system, models, groups, start, slots) for start in STARTS]
    return [drawing for drawing in (*found, _ablation(system, entries)) if drawing is not None]


def _of_start(
    system: str, models: list[str], groups: list[list[Entry]], start: str, slots: dict[str, int]
) -> Drawing | None:
    panels = []
    for quantity in get_args(Quantity):
        series: list[Series] = []
        for i, (model, runs) in enumerate(zip(models, groups, strict=True)):
            series += _of_model(runs, start, quantity, i, slots[model])
        paper = [_printed(system, m, start, quantity, i) for i, m in enumerate(models)]
        series += _dots("paper", [dot for several in paper for dot in several], "paper")
        if any(s.role == "model" for s in series):
            label = f"{quantity} RMSE [{_unit(groups[0][0], quantity)}]"
            panels.append(Panel(_merged(series), "", label, log=True, ticks=tuple(models)))
    if not panels:
        return None
    caption = f"Left without measurements, right of it with the UKF, {start} start. {DOTS}{MEANING}"
    title = f"{system}: RMSE of the models, {start} start"
    return Drawing(f"{file_name(system)}_rmse_{start}", title, caption, tuple(panels), "bars")


MEANING = "RMSE: mean over test trajectories of the rms vector norm; floor: what perfect knowledge scores."


def _of_model(runs: list[Entry], start: str, quantity: Quantity, place: int, slot: int) -> list[Series]:
    model, found = runs[0].model, []
    kinds: tuple[tuple[str | None, str, Role, Role, float], ...] = (
        (None, "", "model", "floor", -BESIDE),
        ("ukf", " + UKF", "filter", "floor", BESIDE),
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
    """Return the scores of the whole span, one for each run that has one."""
    found = []
    for run in runs:
        for row in run.results.rows:
            who = row.who
            if (who.start, who.estimator, who.floor, who.span) == (start, estimator, floor, "whole"):
                value = getattr(row.scores, quantity)
                found += [] if value is None else [float(value)]
                break
    return tuple(found)


def _printed(system: str, model: str, start: str, quantity: Quantity, place: int) -> list[Dot]:
    both = ((False, -BESIDE), (True, BESIDE))
    values = ((published(system, model, start, quantity, ukf=ukf), place + offset) for ukf, offset in both)
    return [Dot(where, (value,)) for value, where in values if value is not None]


def _dots(label: str, dots: Sequence[Dot], role: Role, slot: int = 0) -> list[Series]:
    """Return one series of means with ranges, none where nothing is finite and positive."""
    rows = []
    for dot in dots:
        values = [v for v in dot.values if 0 < v < torch.inf]
        if values:
            rows.append((dot.place, sum(values) / len(values), min(values), max(values)))
    if not rows:
        return []
    x, y, low, high = torch.tensor(rows, dtype=torch.float64).unbind(-1)
    several = bool((high > low).any())
    return [Series(label, x, y, None, role, slot, low if several else None, high if several else None)]


def _merged(series: Sequence[Series]) -> tuple[Series, ...]:
    """Return series with those of one label and role made one, in the order of their first."""
    found: dict[tuple[str, Role], Series] = {}
    for each in series:
        key = each.label, each.role
        old = found.get(key)
        if old is None or each.role in ("model", "filter"):
            found[key] = each
        else:
            found[key] = old._replace(x=torch.cat((old.x, each.x)), y=torch.cat((old.y, each.y)))
    return tuple(found.values())


def _ablation(system: str, entries: Sequence[Entry]) -> Drawing | None:
    """Return scores over the window W of the loss, of Hamiltonian models that assume the same."""
    groups: dict[int, list[Entry]] = {}
    assumes = next((e.results.assumes for e in entries if "Hamiltonian" in e.results.assumes), None)
    for entry in entries:
        window = entry.results.training.get("window")
        if entry.results.assumes == assumes and isinstance(window, int):
            groups.setdefault(window, []).append(entry)
    windows = sorted(groups)
    if len(windows) < 2:
        return None
    panels = [_over_windows(windows, groups, quantity) for quantity in get_args(Quantity)]
    kept = tuple(panel for panel in panels if panel.series)
    names = ", ".join(dict.fromkeys(e.model for w in windows for e in groups[w]))
    caption = f"Of {names}: {assumes}. {DOTS}{MEANING}"
    title = f"{system}: RMSE over the window W of the loss"
    return Drawing(f"{file_name(system)}_windows", title, caption, kept, "bars")


def _over_windows(windows: list[int], groups: dict[int, list[Entry]], quantity: Quantity) -> Panel:
    series: list[Series] = []
    for slot, start in enumerate(("true", "perturbed")):
        for estimator, suffix, role in ((None, "", "model"), ("ukf", " + UKF", "filter")):
            offset = BESIDE * (slot - 0.5) + (0.06 if estimator else 0.0)
            dots = [
                Dot(i + offset, _scores(groups[w], start, quantity, estimator, floor=False))
                for i, w in enumerate(windows)
            ]
            series += _dots(f"{start} start{suffix}", dots, role, slot)
    label = f"{quantity} RMSE [{_unit(groups[windows[0]][0], quantity)}]"
    return Panel(tuple(series), "", label, log=True, ticks=tuple(f"W = {w}" for w in windows))


def _unit(entry: Entry, quantity: Quantity) -> str:
    return getattr(entry.results.space.units, quantity)
