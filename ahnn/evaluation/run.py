"""An evaluation from a trained model to files: scores, plugins, predictions, figures, table."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors.torch import save

from ahnn.data import WindowDataModule
from ahnn.evaluation.case import Case, EvaluationPlugin, Findings, perturbations
from ahnn.evaluation.figures import open_loop_figures
from ahnn.evaluation.open_loop import open_loop
from ahnn.files import write_atomically
from ahnn.integrators import INTEGRATORS
from ahnn.models import AbstractDynamics


def make_case(model: AbstractDynamics, data: WindowDataModule, label: str, seed: int, folder: Path) -> Case:
    """Return the case of a trained model, moved to the CPU and to float64.

    Args:
        model: after fit.
        data: trajectories of its system.
        label: name in tables.
        seed: of the initial errors.
        folder: the run directory.
    """
    flow = model.cpu().flow()
    learner: Any = getattr(flow, "learner", None)
    test = data.trajectories("test")
    return Case(
        label=label,
        system=data.system,
        flow=flow,
        learned_energy=getattr(learner, "energy", None),
        integrator=getattr(model, "integrator", INTEGRATORS["rk4"]),
        test=test,
        validation=data.trajectories("val"),
        train=data.trajectories("train"),
        perturbation=perturbations(data.system, len(test.states), seed),
        folder=folder,
    )


def evaluate(case: Case, plugins: Mapping[str, EvaluationPlugin], *, figures: bool = True) -> Findings:
    """Return the open-loop scores and what each plugin finds, merged; without `figures` nothing is drawn."""
    findings = open_loop(case)
    if figures:
        findings.figures |= open_loop_figures(case, findings.arrays)
    findings.arrays["truth"] = case.test.states
    for name, plugin in plugins.items():
        more = plugin(case)
        findings.rows += more.rows
        findings.numbers[name] = more.numbers
        findings.arrays |= {f"{name}_{key}": value for key, value in more.arrays.items()}
        findings.figures |= {f"{name}_{key}": drawn for key, drawn in more.figures.items() if figures}
    return findings


def write_findings(
    findings: Findings, case: Case, about: dict[str, Any], *, save_predictions: bool = True
) -> None:
    """Write metrics.json, predictions.safetensors and figures/*.png into the run directory."""
    rows = [
        {"name": r.name, "start": r.start, "floor": r.floor, "note": r.note, **r.scores._asdict(), **r.extra}
        for r in findings.rows
    ]
    units = vars(case.system.units)
    content = {**about, "system": case.system.name, "model": case.label, "units": units, "rows": rows}
    content |= {"components": list(case.system.components), **findings.numbers}
    write_atomically(case.folder / "metrics.json", json.dumps(plain(content), indent=2).encode())
    if save_predictions:
        arrays = {key: value.contiguous() for key, value in findings.arrays.items()}
        write_atomically(case.folder / "predictions.safetensors", save(arrays, {"dt": repr(case.test.dt)}))
    folder = case.folder / "figures"
    folder.mkdir(exist_ok=True)
    for name, figure in findings.figures.items():
        figure.savefig(folder / f"{name}.png", dpi=120)


def plain(value: Any) -> Any:
    """Return nested values fit for strict JSON: numbers that are not finite become strings."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value
