"""The numbers that the paper prints, for the systems and models that it has."""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files
from typing import Literal

Quantity = Literal["position", "velocity", "energy"]
SYSTEMS = {"mass_spring": "mass_spring", "molniya": "elliptic_orbit"}
"""What the paper's tables call our systems."""


def published(system: str, model: str, start: str, quantity: Quantity, *, ukf: bool = False) -> float | None:
    """Return a printed RMSE in the units of the system, None where the paper has none.

    Args:
        system: its name.
        model: its name, in any case.
        start: `true` or `perturbed`.
        quantity: of the error.
        ukf: whether the model filters.
    """
    name = model.upper()
    stem = name.rstrip("0123456789")
    row = f"{stem}KF{name[len(stem) :]}" if ukf else name
    return _table().get((SYSTEMS.get(system, ""), row, f"{start}_initial", f"rmse_{quantity}"))


@cache
def _table() -> dict[tuple[str, str, str, str], float]:
    """Return the printed values by system, row, start and quantity."""
    text = files("ahnn_plugins.report").joinpath("paper.csv").read_text()
    found = {}
    for row in csv.DictReader(text.splitlines()):
        system = next(name for name in SYSTEMS.values() if row["table"].endswith(name))
        key = system, row["model"], row["scenario"], row["quantity"]
        found[key] = float(row["value_in_physical_units"])
    return found
