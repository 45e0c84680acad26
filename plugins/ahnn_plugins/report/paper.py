"""Numbers printed in the paper, arXiv 2501.18808, read from data files."""

from __future__ import annotations

import csv
import math
from functools import cache
from importlib.resources import files
from typing import NamedTuple

from ahnn.evaluation.case import Start

FILE = "paper.csv"
SUSPICIOUS = "suspicious.csv"
COLUMNS = ["table", "model", "scenario", "quantity", "value_in_physical_units", "unit"]
REASONS = ["table", "model", "scenario", "quantity", "reason"]
MODELS = ("MLP", "NODE", "HNN", "AHNN3", "AHNN5")
"""Rows of both tables, in the paper's order; `filtered` returns their names with the filter."""

SYSTEMS = {
    "table1_mass_spring": "mass_spring",
    "text_energy_mass_spring": "mass_spring",
    "table2_elliptic_orbit": "molniya",
    "text_energy_elliptic_orbit": "molniya",
}
STARTS: dict[str, Start] = {"true_initial": "true", "perturbed_initial": "perturbed"}
UNITS = {"km^2/s^2": "km²/s²"}


def filtered(model: str) -> str:
    """Return the paper's name of a model with the filter: `AHNNKF3` for `AHNN3`."""
    return f"{model.rstrip('35')}KF{model[len(model.rstrip('35')) :]}"


class PaperCell(NamedTuple):
    """Position of a number in the paper's tables.

    Attributes:
        system: `mass_spring` or `molniya`.
        model: one of `MODELS`.
        filtered: whether the number is with the filter.
        start: start of the prediction.
        quantity: `position`, `velocity` or `energy`.
    """

    system: str
    model: str
    filtered: bool
    start: Start
    quantity: str


class Printed(NamedTuple):
    """Number printed in the paper.

    Attributes:
        value: printed value, in `unit`.
        unit: physical unit.
        doubt: reason why the number is suspicious; "" if it is not.
    """

    value: float
    unit: str
    doubt: str = ""


@cache
def printed() -> dict[PaperCell, Printed]:
    """Return every number of the paper.

    Raises:
        ValueError: a file of the package is damaged.
    """
    folder = files("ahnn_plugins.report")
    reasons = read_rows(folder.joinpath(SUSPICIOUS).read_text("utf-8"), REASONS)
    doubts = {place(row): row["reason"] for row in reasons}
    numbers = read_numbers(folder.joinpath(FILE).read_text("utf-8"))
    if unknown := doubts.keys() - numbers.keys():
        message = f"{SUSPICIOUS}: expected cells of {FILE}; received {sorted(unknown)[0]}"
        raise ValueError(message)
    return {key: number._replace(doubt=doubts.get(key, "")) for key, number in numbers.items()}


def printed_value(system: str, model: str, start: str, quantity: str, *, ukf: bool = False) -> float | None:
    """Return a printed number of a model, by case-insensitive name; None if the paper has none."""
    places = (
        PaperCell(system, model.upper(), ukf, known, quantity) for known in STARTS.values() if known == start
    )
    return next((printed()[place].value for place in places if place in printed()), None)


def read_numbers(text: str) -> dict[PaperCell, Printed]:
    """Read the numbers of a table with the columns `COLUMNS`.

    Raises:
        ValueError: other columns, a duplicate cell, an unknown name, or a value that is not positive.
    """
    found: dict[PaperCell, Printed] = {}
    for row in read_rows(text, COLUMNS):
        key, value = place(row), float(row["value_in_physical_units"])
        if key in found or not (math.isfinite(value) and value > 0):
            message = f"{FILE}: expected one number above zero for {key}; received {value:g}, or two numbers"
            raise ValueError(message)
        found[key] = Printed(value, UNITS.get(row["unit"], row["unit"]))
    return found


def read_rows(text: str, columns: list[str]) -> list[dict[str, str]]:
    """Read the rows of a table; raises ValueError for other columns or a row of the wrong length."""
    head, *rows = csv.reader(text.splitlines())
    if head != columns or any(len(row) != len(columns) for row in rows):
        message = f"expected the columns {', '.join(columns)} in every row; received {', '.join(head)}"
        raise ValueError(message)
    return [dict(zip(columns, row, strict=True)) for row in rows]


def place(row: dict[str, str]) -> PaperCell:
    """Return the position of a row's number; raises ValueError for an unknown name."""
    names = {filtered(model): (model, True) for model in MODELS} | {m: (m, False) for m in MODELS}
    quantity = row["quantity"].removeprefix("rmse_")
    if quantity not in ("position", "velocity", "energy"):
        message = f"quantity: expected rmse_position, rmse_velocity or rmse_energy; received {quantity!r}"
        raise ValueError(message)
    try:
        model, with_filter = names[row["model"]]
        return PaperCell(SYSTEMS[row["table"]], model, with_filter, STARTS[row["scenario"]], quantity)
    except KeyError as error:
        message = f"expected a name from the paper; received {error}"
        raise ValueError(message) from error
