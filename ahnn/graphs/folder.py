"""Folder of an exported model: graphs, weights, and a JSON description."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from torch import nn

from ahnn.checkpoints import Weights, checksum, packed
from ahnn.errors import UserError
from ahnn.evaluation.provenance import provenance
from ahnn.files import whole_folder
from ahnn.graphs.modules import ClockedStepModule, modules
from ahnn.graphs.programs import CLOCK, INPUT, OUTPUT, as_onnx, as_pt2, program, require_onnx
from ahnn.progress import track
from ahnn.runs import Run
from ahnn.stored import SAVED, about_space

FORMAT = 2
"""Version of model.json, increased when its meaning changes."""
ABOUT = "model.json"
SHAPES = {"flow": ["batch", "components"], "energy": ["batch"]}


def write_export(run: Run, folder: Path) -> list[str]:
    """Write an exported model and return the names of its files; the folder is written atomically.

    Raises:
        UserError: the folder exists, a package is missing, or the model cannot be exported.
    """
    if os.path.lexists(folder):
        message = f"output: expected a new folder; received {folder}, which exists"
        raise UserError(message)
    require_onnx()
    parts = modules(run.dynamics, run.dt)
    with whole_folder(folder) as place:
        for name, module in track(parts.items(), "exporting", len(parts)):
            clock = [run.dynamics.clock] if isinstance(module, ClockedStepModule) else []
            found = program(module, len(run.space.components), *clock)
            (place / f"{name}.pt2").write_bytes(as_pt2(found))
            (place / f"{name}.onnx").write_bytes(as_onnx(found))
        (place / SAVED).write_bytes(packed(Weights(run.dynamics.state_dict(), run.about)))
        (place / ABOUT).write_text(json.dumps(about(run, parts), indent=2) + "\n")
        return sorted(path.name for path in place.iterdir())


def about(run: Run, parts: dict[str, nn.Module]) -> dict[str, Any]:
    """Return the metadata of an exported model as plain values."""
    made = provenance()
    kept = {name: made[name] for name in ("ahnn", "commit", "torch", "date")}
    state = run.dynamics.state_dict()
    known = ["time", *run.space.controls][: run.dynamics.clock]
    clock = {"name": CLOCK, "type": "float64", "shape": ["batch", "clock"], "components": known}
    return {
        "format": FORMAT,
        "space": about_space(run.space) | {"units": run.space.units._asdict()},
        "dt": run.dt,
        "dynamics": run.dynamics.spec,
        "assumes": run.dynamics.assumes,
        "scalings": {name: value.tolist() for name, value in run.dynamics.named_buffers()},
        "graphs": {
            name: {
                "files": [f"{name}.pt2", f"{name}.onnx"],
                "input": {"name": INPUT, "type": "float64", "shape": ["batch", "components"]},
                **({"clock": clock} if known and name == "flow" else {}),
                "output": {"name": OUTPUT, "type": "float64", "shape": SHAPES[name]},
            }
            for name in parts
        },
        "training": {name: run.about.get(name) for name in ("data", "settings", "val_loss")},
        "domain": run.about.get("domain"),
        "provenance": {**kept, "sha256_of_weights": checksum(state, "")},
    }
