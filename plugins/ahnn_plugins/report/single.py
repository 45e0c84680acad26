"""Page of one run: scores with floors, consistency, figures, settings and provenance."""

from __future__ import annotations

from ahnn.data.reference import Reference
from ahnn.evaluation.results import plain
from ahnn.evaluation.titles import described
from ahnn.labels import quantity
from ahnn_plugins.report.collection import Collection, Entry
from ahnn_plugins.report.document import Section
from ahnn_plugins.report.grid import Grid, shown
from ahnn_plugins.report.layout import grid_html
from ahnn_plugins.report.many import definitions, remarks_html
from ahnn_plugins.report.markup import Markup, escaped, tag
from ahnn_plugins.report.overviews import number, score_table
from ahnn_plugins.report.pictures import Picture, figures_html
from ahnn_plugins.report.plugin_numbers import consistency_table, listed
from ahnn_plugins.report.remarks import remarks
from ahnn_plugins.report.scores import QUANTITIES, board
from ahnn_plugins.report.settings import text_of


def tables(collection: Collection) -> dict[str, list[Grid]]:
    """Return the tables of a run."""
    (entry,) = collection.entries
    found = [
        score_table(board(collection, entry.system)),
        consistency_table(entry.system, entry.results.numbers),
    ]
    return {entry.system: [grid for grid in found if grid is not None]}


def sections(collection: Collection, grids: dict[str, list[Grid]], pictures: list[Picture]) -> list[Section]:
    """Return the sections of the page."""
    (entry,) = collection.entries
    scores, *others = grids[entry.system]
    results = entry.results
    notes = [
        f"{described(row.who, results.label)}: {one}" for row in results.rows for one in row.note.splitlines()
    ]
    sentences = [*remarks(board(collection, entry.system)), *notes]
    drawn = [Section("figures", "Figures", figures_html(pictures))] if pictures else []
    consistent = (
        [Section("consistency", "Consistency", escaped(list(map(grid_html, others))))] if others else []
    )
    numbers = [Section("numbers", "Further numbers", _numbers(entry))] if results.numbers else []
    return [
        Section("summary", "Summary", escaped([_verdict(entry), _training(entry), remarks_html(sentences)])),
        Section("scores", "Scores", grid_html(scores)),
        *consistent,
        *drawn,
        *numbers,
        Section("settings", "Settings", _settings(entry)),
        Section("provenance", "Provenance", _provenance(entry)),
    ]


def _verdict(entry: Entry) -> Markup:
    if not entry.results.verdict:
        return Markup()
    judged, *reasons = entry.results.verdict
    return escaped([tag("p", tag("strong", judged)), remarks_html(reasons)])


def _training(entry: Entry) -> Markup:
    training, space = entry.results.training, entry.results.space
    values = {key: number(training, key) for key in training}
    frame = Reference.of(space.frame).assumed(space.units.position).described()
    facts = {
        "model": entry.model,
        "prior knowledge": entry.results.assumes or "not said",
        "system": entry.system,
        "state": ", ".join(space.components) + (f" in {frame}" if frame else ""),
        "units": f"{', '.join(quantity(space, q)[1] for q in QUANTITIES)}; time in {space.units.time}",
        **{_named(key): _shown(value, training[key]) for key, value in values.items()},
    }
    return definitions(facts)


def _named(key: str) -> str:
    return {"seconds": "training [s]", "steps": "optimiser steps", "val_loss": "validation loss"}.get(
        key, key
    )


def _shown(value: float | None, said: object) -> str:
    if value is None:
        return str(said)[:500]
    return f"{value:.0f}" if value.is_integer() and abs(value) < 1e15 else shown(value)


def _numbers(entry: Entry) -> Markup:
    parts = [
        tag("details", tag("summary", name.replace("_", " ")), definitions(dict(facts)), class_="more")
        for name, value in entry.results.numbers.items()
        if name != "verdict" and (facts := [*listed(plain(value))])
    ]
    return escaped([tag("p", "Further results of the evaluations; long lists are cut."), *parts])


def _settings(entry: Entry) -> Markup:
    text = text_of(entry.folder)
    if not text:
        return tag("p", "The folder contains no config.yaml.")
    shown_text = tag("pre", text, tabindex="0")
    return tag("details", tag("summary", "config.yaml, as the training stored it"), shown_text)


def _provenance(entry: Entry) -> Markup:
    about = {key: str(value)[:2000] for key, value in entry.results.about.items() if value is not None}
    return definitions({"folder": str(entry.folder), **about})
