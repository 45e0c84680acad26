"""Tables 1 and 2 of the paper in its layout and units, with numbers of the runs and of the paper."""

from __future__ import annotations

import math
from typing import NamedTuple

from ahnn.evaluation.case import Start
from ahnn.evaluation.titles import estimator_title
from ahnn_plugins.report.grid import NONE, Cell, Grid, Head, Line, as_printed, mean_and_spread, shown
from ahnn_plugins.report.paper import MODELS, Printed, filtered
from ahnn_plugins.report.scores import Board, Measure

STARTS: tuple[Start, ...] = ("true", "perturbed")
SUB = (Head("ours"), Head("paper"), Head("floor"))


class PaperLayout(NamedTuple):
    """Layout of a table of the paper: number, title and units."""

    number: int
    title: str
    units: dict[str, tuple[float, str]]


LAYOUTS = {
    "mass_spring": PaperLayout(
        1, "RMSE for the mass-spring system", {"position": (1e-4, "10⁻⁴ m"), "velocity": (1e-4, "10⁻⁴ m/s")}
    ),
    "molniya": PaperLayout(
        2,
        "RMSE for the highly elliptic orbit",
        {"position": (1e2, "10² km"), "velocity": (1e-1, "10⁻¹ km/s")},
    ),
}


def is_of_paper(board: Board) -> bool:
    """Return whether there are runs of the paper's system in its units, with one of its models."""
    measures = (Measure(model) for model in MODELS if model in board.groups)
    return any(board.printed(measure) is not None for measure in measures)


def rmse_table(board: Board) -> Grid:
    """Build Table 1 or 2: rows of models with and without the filter, columns of starts and quantities."""
    layout = LAYOUTS[board.system]
    columns: list[tuple[Start, str]] = [(s, quantity) for s in STARTS for quantity in layout.units]
    doubts = _doubts(board, columns)
    lines = []
    for with_filter in (False, True):
        lines.append(Line(_section(board, with_filter)))
        best = {key: _best(board, *key, with_filter) for key in columns}
        for model in MODELS:
            cells: list[Cell] = []
            for start, quantity in columns:
                measure = Measure(model, quantity, start, with_filter)
                is_best = best[start, quantity] == model
                cells += _cells(board, measure, layout.units[quantity][0], doubts, is_best=is_best)
            lines.append(Line(filtered(model) if with_filter else model, tuple(cells)))
    starts = {"true": "True initial state", "perturbed": "Perturbed initial state"}
    heads = (
        (Head(""), *(Head(starts[start], 6) for start in STARTS)),
        (Head("Model"), *(Head(f"{q} [{layout.units[q][1]}]", 3) for _, q in columns)),
        (Head(""), *(SUB * len(columns))),
    )
    caption = (
        "Mean over trajectories of the rms vector norm; ours: mean ± standard deviation over seeds, the "
        "lowest mean of each part bold; paper: as printed, suspicious cells marked; floor: score of the "
        "exact equations."
    )
    title = f"Table {layout.number} of the paper. {layout.title}."
    return Grid(f"table{layout.number}_{board.system}", title, caption, heads, tuple(lines), tuple(doubts))


def energy_table(board: Board) -> Grid:
    """Build the table of energy RMSEs given in the paper's text, from the true start without the filter."""
    unit = board.entries[0].results.space.units.energy
    lines = []
    best = _best(board, "true", "energy", with_filter=False)
    for model in MODELS:
        cells = _cells(board, Measure(model, "energy"), 1.0, [], is_best=model == best)
        lines.append(Line(model, tuple(cells)))
    caption = (
        "Root mean square over trajectories and times of H(prediction) - H(truth), true start, no filter."
    )
    if board.system == "molniya":
        caption += " The paper says J for 1 kg with lengths in km: that is km²/s², or MJ."
    heads = ((Head("Model"), Head(f"energy [{unit}]", 3)), (Head(""), *SUB))
    return Grid(f"energy_{board.system}", "Energy RMSE.", caption, heads, tuple(lines))


def _section(board: Board, with_filter: bool) -> str:
    if not with_filter:
        return "without measurements"
    if board.estimator is None:
        return "with the UKF: no run was evaluated with a filter (plugins=ukf)"
    return f"with the {estimator_title(board.estimator)}"


def _doubts(board: Board, columns: list[tuple[Start, str]]) -> list[str]:
    """Return the doubts about cells, without duplicates, in the order of the table."""
    cells = (
        board.printed(Measure(model, quantity, start, with_filter))
        for with_filter in (False, True)
        for model in MODELS
        for start, quantity in columns
    )
    return list(dict.fromkeys(f"Suspicious: {cell.doubt}." for cell in cells if cell and cell.doubt))


def _best(board: Board, start: Start, quantity: str, with_filter: bool) -> str | None:
    """Return the model with the lowest mean; None for fewer than two means."""
    means = {m: board.sample(Measure(m, quantity, start, with_filter)).mean for m in MODELS}
    finite = {model: mean for model, mean in means.items() if math.isfinite(mean)}
    return min(finite, key=lambda model: finite[model]) if len(finite) > 1 else None


def _cells(board: Board, measure: Measure, scale: float, doubts: list[str], *, is_best: bool) -> list[Cell]:
    """Return the cells of our value, the paper's value and the floor."""
    own, floor, said = board.sample(measure), board.floor(measure), board.printed(measure)
    return [
        Cell(mean_and_spread(own, scale), "best" if is_best else ""),
        _printed(said, scale, doubts),
        Cell(shown(floor.mean / scale if floor.values else None, 2), "quiet"),
    ]


def _printed(said: Printed | None, scale: float, doubts: list[str]) -> Cell:
    if said is None:
        return Cell(NONE, "quiet")
    note = doubts.index(f"Suspicious: {said.doubt}.") + 1 if said.doubt and doubts else 0
    return Cell(as_printed(said.value / scale), "quiet", note)
