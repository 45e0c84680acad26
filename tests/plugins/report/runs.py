"""Run folders made by hand: results as an evaluation writes them, nothing trained."""

from __future__ import annotations

import json
import math
from pathlib import Path

from ahnn.evaluation import Results, Row, Who
from ahnn.evaluation.results import encoded
from ahnn.metrics import Scores
from ahnn.types import Space, Units
from ahnn_plugins.report.paper import MODELS, PaperCell, printed

SPRING = Space("mass_spring", ("q", "p"), Units("s", "m", "m/s", "J"))
ORBIT = Space("molniya", ("x", "y", "z", "px", "py", "pz"), Units("s", "km", "km/s", "km²/s²"))
SEEDS = (7, 201, 719)
SPREAD = {7: 1.02, 201: 0.98, 719: 1.0}
KNOWN = {"MLP": "nothing", "NODE": "a vector field"}
WINDOWS = {"AHNN3": 3, "AHNN5": 5}
FLOORS = {"true": 1e-8, "perturbed": 2e-4}


def scores(position: float, velocity: float | None = None, energy: float | None = 1e-3) -> Scores:
    second = 2 * position if velocity is None else velocity
    return Scores(position, second, position, second, energy, (position, second))


def results(rows: list[Row], label: str = "HNN", seed: int = 7, space: Space = SPRING, **changes) -> Results:
    training = {"seed": seed, "seconds": 10.0, "window": WINDOWS.get(label, 1), "steps": 100}
    training |= {"parameters": 4417, "val_loss": 1e-3}
    about = {"ahnn": "0.2.0", "commit": "0123456789abcdef", "date": "2026-01-02T03:04:05", "command": "train"}
    whole = {"training": training, "about": about} | changes
    return Results(label, KNOWN.get(label, "generic Hamiltonian"), space, tuple(rows), **whole)


def write(folder: Path, found: Results) -> Path:
    folder.mkdir(parents=True)
    (folder / "metrics.json").write_text(json.dumps(encoded(found)))
    return folder


def paper_rows(system: str, model: str, factor: float, *, filtered: bool = True) -> list[Row]:
    """Rows whose scores are the paper's numbers times a factor, with floors far below."""
    rows = []
    for with_filter in (False, True) if filtered else (False,):
        for start in ("true", "perturbed"):
            values = [
                number.value * factor
                for quantity in ("position", "velocity")
                if (number := printed()[PaperCell(system, model, with_filter, start, quantity)])
            ]
            energy = printed().get(PaperCell(system, model, with_filter, start, "energy"))
            estimator = "ukf" if with_filter else None
            found = scores(*values, energy.value * factor if energy else math.pi)
            rows.append(Row(Who("model", start, estimator), found))
            rows.append(Row(Who("exact flow", start, estimator, floor=True), scores(FLOORS[start])))
    return rows


def reproduction(folder: Path, space: Space = SPRING, seeds=SEEDS, models=MODELS, **options) -> Path:
    """A reproduction that finds the paper's numbers, with a spread of two per cent over seeds."""
    for model in models:
        for seed in seeds:
            rows = paper_rows(space.name, model, SPREAD[seed], **options)
            write(folder / f"{model}_{seed}", results(rows, model, seed, space))
    return folder
