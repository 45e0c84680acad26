"""Score table 80 characters wide: model and floor in adjacent columns, notes below."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from ahnn.evaluation.case import Row, Who
from ahnn.evaluation.results import Results
from ahnn.evaluation.terminal import WIDTH
from ahnn.evaluation.titles import MODEL, TEXTBOOK, described, estimator_title, title
from ahnn.labels import headed, quantity
from ahnn.numbers import in_percent

NUMBER = 9
"""Width of a number; the longest are of the form `1.23e-300`."""
FEW = 4
"""Number of unseen trajectories up to which the table states it, since their mean says little of others."""

QUANTITIES = ("position", "velocity", "energy")


class ScoreLine(NamedTuple):
    """Line of the table.

    Attributes:
        section: section heading.
        name: start and span.
        rows: rows of the model and of the floor, or None.
    """

    section: str
    name: str
    rows: tuple[Row | None, Row | None]


def results_table(results: Results, *, detail: bool = False) -> str:
    """Format the table of an evaluation.

    Args:
        results: results of the evaluation.
        detail: whether to add all notes, pooled errors and errors per component to the first line of the
            verdict, instead of its other lines.
    """
    head = f"{results.label} on {results.space.name}" + (f": {results.assumes}" if results.assumes else "")
    lines = table_lines(results.rows, results.label)
    parts = [*_wrapped(head), "", *_columns(lines, results), "", *_explanations(results)]
    verdict = results.verdict
    if verdict:
        shown = verdict[:1] if detail else verdict
        parts += ["", *(line for one in shown for line in _wrapped(one, hanging=True))]
    if detail or not verdict:
        head = verdict[0] if verdict else ""
        for row in results.rows:
            if findings := [line for line in row.note.splitlines() if line not in head]:
                parts += _noted(described(row.who, results.label), findings)
    if detail:
        parts.append("")
        parts += [part for row in results.rows for part in _wrapped(_details(row, results), hanging=True)]
    return "\n".join(parts)


def table_lines(rows: Iterable[Row], label: str) -> list[ScoreLine]:
    """Return the lines of a table, ordered by section; each row is on one line.

    A floor shares a line with the model of the same estimator, start and span; another process, or a second
    floor, has its own section.
    """
    lines: list[ScoreLine] = []
    for row in rows:
        side = int(row.who.floor)
        at = _slot(lines, row.who, label)
        pair = list(lines[at].rows)
        pair[side] = row
        lines[at] = lines[at]._replace(rows=(pair[0], pair[1]))
    order = list(dict.fromkeys(line.section for line in lines))
    return sorted(lines, key=lambda line: order.index(line.section))


def _slot(lines: list[ScoreLine], who: Who, label: str) -> int:
    """Return the index of the line with a free slot for a row, adding a line if necessary."""
    own = title(who, label)
    section = own
    for section in (_section(who), own) if who.floor or who.process == MODEL else (own,):
        there = [i for i, line in enumerate(lines) if (line.section, line.name) == (section, _name(who))]
        free = [i for i in there if lines[i].rows[int(who.floor)] is None]
        if free:
            return free[0]
        if not there:
            break
    lines.append(ScoreLine(section, _name(who), (None, None)))
    return len(lines) - 1


def _section(who: Who) -> str:
    return "no measurements" if who.estimator is None else estimator_title(who.estimator)


def _name(who: Who) -> str:
    return f"{who.start} start" if who.span == "whole" else f"{who.start}, {who.span}"


def _columns(lines: list[ScoreLine], results: Results) -> Iterator[str]:
    """Yield head and body, omitting empty columns."""
    sides = [side for side in (0, 1) if any(line.rows[side] for line in lines)]
    known = [quantity for quantity in QUANTITIES if _any(lines, quantity)]
    body = [
        (line, [[_cell(line.rows[side], quantity) for side in sides] for quantity in known]) for line in lines
    ]
    least = 7 if len(sides) > 1 else 17
    width = max([least, *(len(cell) for _, cells in body for group in cells for cell in group)])
    between = "  " if width < NUMBER else " "
    group = len(sides) * (width + 1) - 1
    heads = [textwrap.wrap(headed(results.space, quantity), group) for quantity in known]
    depth = max((len(head) for head in heads), default=0)
    names = max([18, *(2 + len(line.name) for line in lines)])
    for i in range(depth):
        texts = (head[i - depth + len(head)] if i >= depth - len(head) else "" for head in heads)
        yield (" " * names + "".join(f"{between}{text:>{group}}" for text in texts)).rstrip()
    if len(sides) > 1:
        yield " " * names + len(known) * f"{between}{'model':>{width}} {'floor':>{width}}"
    section = "no measurements" if {line.section for line in lines} == {"no measurements"} else None
    for line, cells in body:
        if line.section != section:
            yield from _wrapped(section := line.section)
        values = (" ".join(f"{cell:>{width}}" for cell in row) for row in cells)
        yield f"  {line.name}".ljust(names) + "".join(f"{between}{value}" for value in values)


def _any(lines: list[ScoreLine], quantity: str) -> bool:
    rows = (row for line in lines for row in line.rows if row is not None)
    return any(_scored(row, getattr(row.scores, quantity)) for row in rows)


def _scored(row: Row, value: float | None) -> bool:
    """Return whether a score is available: unmeasured components have none."""
    return value is not None and not (row.who.start == "fitted" and math.isnan(value))


def _cell(row: Row | None, quantity: str) -> str:
    return number(None if row is None else getattr(row.scores, quantity))


def _explanations(results: Results) -> Iterator[str]:
    """Yield explanations of the columns and sections present."""
    stated = results.numbers.get("unseen")
    count = stated.get("trajectories") if isinstance(stated, dict) else None
    few = f"only {count} " if isinstance(count, int) and 1 < count <= FEW else ""
    yield from _wrapped(f"RMSE over {few}unseen trajectories: mean over trajectories of the rms vector norm.")
    floors = dict.fromkeys(title(row.who, results.label) for row in results.rows if row.who.floor)
    if floors:
        yield from _wrapped(f"floor: score of perfect knowledge ({'; '.join(floors)}).")
    if any(row.who.process == TEXTBOOK for row in results.rows):
        yield from _wrapped(f"{TEXTBOOK}: a satellite of the oblate Earth, without learning.")
    if about := about_fitted(results.rows):
        yield from _wrapped(about)
    if any(row.who.span == "settled" for row in results.rows):
        yield from _wrapped("settled: scores after the first update.")


def about_fitted(rows: Iterable[Row]) -> str:
    """Return what the scores from fitted starts mean, in every table and figure of them; "" without any."""
    fitted = [row for row in rows if row.who.start == "fitted"]
    if not fitted:
        return ""
    fractions = {row.extra.get("outliers") for row in fitted}
    excluded = fractions.pop() if len(fractions) == 1 else None
    without = f"; {in_percent(excluded)} outliers excluded" if excluded else ""
    return (
        "fitted start: initial state that best fits the measurements; errors are differences from the "
        f"measurements and include their noise{without}."
    )


def _details(row: Row, results: Results) -> str:
    """Format those scores of a row that have no column in the table; unmeasured components have none."""
    space, names, scores = results.space, results.space.components, row.scores
    over = "/m" if space.mechanical else ""
    labels = [*names[: space.dof], *(name + over for name in names[space.dof :])]
    known = [
        f"{name} {number(value)}"
        for name, value in zip(labels, scores.components, strict=False)
        if not math.isnan(value)
    ]
    pooled = zip(QUANTITIES, (scores.position_pooled, scores.velocity_pooled), strict=False)
    whole = [
        " ".join(("pooled", what, number(value), unit))
        for (what, unit), value in ((quantity(space, name), value) for name, value in pooled)
        if not math.isnan(value)
    ]
    parts = [", ".join(whole), f"components {', '.join(known)}" if known else ""]
    return f"{described(row.who, results.label)}: {'; '.join(filter(None, parts)) or 'no errors'}"


def _noted(who: str, findings: list[str]) -> list[str]:
    """Format notes: a single finding after the name of its row, several findings below it."""
    if len(findings) == 1:
        return _wrapped(f"{who}: {findings[0]}", hanging=True)
    below = (textwrap.wrap(one, WIDTH, initial_indent="  ", subsequent_indent="    ") for one in findings)
    return [*_wrapped(f"{who}:", hanging=True), *(line for lines in below for line in lines)]


def _wrapped(text: str, *, hanging: bool = False) -> list[str]:
    return textwrap.wrap(text, WIDTH, subsequent_indent="  " if hanging else "") or [""]


def number(value: float | None) -> str:
    """Format a number with three or four digits, in the shorter notation and at most nine characters.

    An exponent is never truncated; missing values are shown as `-`.
    """
    if value is None:
        return "-"
    size = abs(value)
    style = "#.3g" if 1e-2 <= size < 999.5 else ".0f" if 999.5 <= size < 9999.5 or size == 0 else ".2e"
    text = f"{value:{style}}".rstrip(".")
    return text if len(text) <= NUMBER else f"{value:.1e}"
