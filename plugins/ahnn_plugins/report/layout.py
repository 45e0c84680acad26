"""HTML and LaTeX of a table."""

from __future__ import annotations

import re

from ahnn_plugins.report.grid import Cell, Grid, Head
from ahnn_plugins.report.markup import Markup, safe_name, tag

LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "%": r"\%",
    "#": r"\#",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"$<$",
    ">": r"$>$",
    "±": r"$\pm$",
    "×": r"$\times$",
    "²": r"$^{2}$",
    "³": r"$^{3}$",
    "·": r"$\cdot$",
    "∞": r"$\infty$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "−": r"$-$",
    "–": "--",
    "√": r"$\surd$",
    "σ": r"$\sigma$",
    "µ": r"$\mu$",
    "μ": r"$\mu$",
}
SUPERSCRIPTS = "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"
POWER = re.compile(rf"10([{SUPERSCRIPTS}]+)")


def letter(note: int) -> str:
    """Return the mark of a footnote: a, b, ... z, aa, ab, ..."""
    text = ""
    while note > 0:
        note, rest = divmod(note - 1, 26)
        text = chr(97 + rest) + text
    return text


def grid_html(grid: Grid) -> Markup:
    """Return a table in a separately scrolling frame."""
    first = next((line.cells for line in grid.lines if line.cells), ())
    words = [False, *(cell.tone == "words" for cell in first)]
    head = tag("thead", [_heads(row, words) for row in grid.heads])
    body = tag("tbody", [_line(line.name, line.cells, grid.columns) for line in grid.lines])
    caption = tag("caption", tag("strong", grid.title), " ", grid.caption)
    table = tag("table", caption, head, body)
    frame = tag("div", table, class_="scroll", tabindex="0", role="region", aria_label=grid.title)
    notes = [tag("li", tag("sup", letter(i)), " ", note) for i, note in enumerate(grid.notes, 1)]
    below = [tag("ul", notes, class_="notes")] if notes else []
    return tag("div", frame, below, class_="grid", id=safe_name(grid.name))


def _heads(row: tuple[Head, ...], words: list[bool]) -> Markup:
    """Return a row of headings, left-aligned over text columns."""
    cells, column = [], 0
    for head in row:
        kind = "words" if head.span == 1 and words[column : column + 1] == [True] else None
        scope = "col" if head.span == 1 else "colgroup"
        cells.append(tag("th", head.text, scope=scope, colspan=head.span, class_=kind))
        column += head.span
    return tag("tr", cells)


def _line(name: str, cells: tuple[Cell, ...], columns: int) -> Markup:
    if not cells:
        return tag("tr", tag("th", name, scope="rowgroup", colspan=columns), class_="group")
    return tag("tr", tag("th", name, scope="row"), [_cell(cell) for cell in cells])


def _cell(cell: Cell) -> Markup:
    mark = [tag("sup", letter(cell.note))] if cell.note else []
    return tag("td", cell.text, mark, class_=cell.tone or None)


def grid_latex(grid: Grid) -> str:
    """Return a LaTeX table, which requires the package booktabs."""
    first = next((line.cells for line in grid.lines if line.cells), ())
    kinds = "".join("l" if cell.tone == "words" else "r" for cell in first)
    lines = [
        rf"\begin{{table}}\caption{{{latex(grid.title)} {latex(grid.caption)}}}",
        rf"\label{{tab:{safe_name(grid.name)}}}",
        rf"\centering\begin{{tabular}}{{l{kinds}}}\toprule",
    ]
    for row in grid.heads:
        lines.append(" & ".join(_multicolumn(head) for head in row) + r" \\")
        lines += _rules(row)
    lines.append(r"\midrule")
    for line in grid.lines:
        if not line.cells:
            lines.append(
                rf"\addlinespace \multicolumn{{{grid.columns}}}{{l}}{{\itshape {latex(line.name)}}} \\"
            )
            continue
        lines.append(" & ".join([latex(line.name), *map(_latex_cell, line.cells)]) + r" \\")
    lines.append(r"\bottomrule\end{tabular}")
    lines += [
        rf"\par\footnotesize\textsuperscript{{{letter(i)}}} {latex(n)}" for i, n in enumerate(grid.notes, 1)
    ]
    return "\n".join([*lines, r"\end{table}", ""])


def _multicolumn(head: Head) -> str:
    return latex(head.text) if head.span == 1 else rf"\multicolumn{{{head.span}}}{{c}}{{{latex(head.text)}}}"


def _rules(row: tuple[Head, ...]) -> list[str]:
    """Return the rules under headings over several columns."""
    rules, column = [], 1
    for head in row:
        if head.span > 1:
            rules.append(rf"\cmidrule(lr){{{column}-{column + head.span - 1}}}")
        column += head.span
    return ["".join(rules)] if rules else []


def _latex_cell(cell: Cell) -> str:
    text = rf"\textbf{{{latex(cell.text)}}}" if cell.tone == "best" else latex(cell.text)
    return text + (rf"\textsuperscript{{{letter(cell.note)}}}" if cell.note else "")


def latex(text: str) -> str:
    """Escape a text for LaTeX."""
    plain = POWER.sub(lambda m: f"10\0{''.join(_digit(sign) for sign in m[1])}\1", " ".join(text.split()))
    signs = "".join(LATEX.get(sign, sign) for sign in plain)
    return signs.replace("\0", "$^{").replace("\1", "}$")


def _digit(sign: str) -> str:
    return "-0123456789"[SUPERSCRIPTS.index(sign)]
