"""Markdown output of tables."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable

from ahnn_plugins.report.grid import Cell, Grid, Head
from ahnn_plugins.report.layout import letter

SIGNS = re.compile(r"[\\`*_{}\[\]#|~!$]")
"""Characters with a special meaning in Markdown."""


def grid_markdown(grid: Grid) -> str:
    """Render a table with pipes, with its title and caption above it and its footnotes below."""
    columns = [*map(list, zip(*map(_spread, grid.heads), strict=True))]
    heads = [", ".join(dict.fromkeys(filter(None, column))) for column in columns]
    first = next((line.cells for line in grid.lines if line.cells), ())
    rules = ["---", *("---" if cell.tone == "words" else "--:" for cell in first)]
    lines = [_row(heads), _row(rules)]
    for line in grid.lines:
        cells = map(_cell, line.cells) if line.cells else [""] * (grid.columns - 1)
        lines.append(_row([line.name and markdown(line.name), *cells]))
    notes = [f"{letter(i)}: {markdown(note)}  " for i, note in enumerate(grid.notes, 1)]
    head = f"**{markdown(grid.title)}** {markdown(grid.caption)}".strip()
    return "\n".join([head, "", *lines, *(["", *notes] if notes else []), ""])


def markdown(text: str) -> str:
    """Escape a text for one line of Markdown."""
    return SIGNS.sub(lambda sign: f"\\{sign[0]}", html.escape(" ".join(text.split()), quote=False))


def _spread(row: tuple[Head, ...]) -> list[str]:
    """Return the heading above each column."""
    return [markdown(head.text) for head in row for _ in range(head.span)]


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(cell: Cell) -> str:
    text = f"**{markdown(cell.text)}**" if cell.tone == "best" and cell.text else markdown(cell.text)
    return text + (f"<sup>{letter(cell.note)}</sup>" if cell.note else "")
