"""Run folders without a training: the exact flow a little off, under the names that an evaluation keeps."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import torch
import yaml
from safetensors.torch import save_file
from torch import Tensor

from ahnn.data.generate import generate
from ahnn.evaluation.case import Row, Who
from ahnn.evaluation.results import FILE, Results, encoded
from ahnn.metrics import Scores
from ahnn.systems import MassSpring, Molniya, System
from ahnn.types import Space

SPRING = MassSpring(name="mass_spring", dt=0.01, steps=60, mass=2.0)
ORBITS = Molniya(name="molniya", dt=60.0, steps=900)
OFF = {"MLP": 3e-2, "HNN": 1e-3, "AHNN3": 5e-4, "AHNN5": 1e-4}


def scores(size: float) -> Scores:
    return Scores(size, 2 * size, size, 2 * size, 3 * size, (size, size))


def results(space: Space, model: str, seed: int, *, truth: bool = True) -> Results:
    size = OFF.get(model, 1e-2) * (1 + seed / 1000)
    rows = [
        Row(Who("model", start, estimator), scores(size if estimator is None else size / 2))
        for start in ("true", "perturbed")
        for estimator in (None, "ukf")
    ]
    if truth:
        rows += [Row(Who("exact flow", start, floor=True), scores(1e-6)) for start in ("true", "perturbed")]
    window = {"AHNN3": 3, "AHNN5": 5}.get(model, 1)
    training = {"seed": seed, "window": window}
    assumes = "nothing" if model == "MLP" else "generic Hamiltonian"
    return Results(model, assumes, space, tuple(rows), training)


def arrays(system: System, model: str, seed: int) -> dict[str, Tensor]:
    """What an evaluation with a filter keeps of three trajectories."""
    truth, times, *_ = generate(system, 3, seed=1)
    generator = torch.Generator().manual_seed(seed)
    size = truth.abs().amax((0, 1))

    def near(amount: float) -> Tensor:
        drift = torch.linspace(0, 1, truth.shape[1], dtype=torch.float64)[:, None]
        return truth + amount * size * drift * torch.rand(truth.shape[-1], generator=generator).double()

    off = OFF.get(model, 1e-2)
    found = {"truth": truth, "times": times}
    for start in ("true", "perturbed"):
        found |= {f"{start}_start": near(off), f"floor_{start}_start": near(1e-9)}
        found |= {
            f"ukf/{start}_start": near(off / 2),
            f"ukf/{start}_nees": 2 * torch.ones(times.shape).double(),
        }
        found[f"ukf/{start}_sma_floor"] = torch.full((2, times.shape[1]), 1e-6, dtype=torch.float64)
    return found | teeth(truth[1], off * size)


def teeth(truth: Tensor, deviation: Tensor) -> dict[str, Tensor]:
    """The filter along trajectory 1: half a deviation off, but exact after updates at every 20th sample."""
    twice = truth.repeat_interleave(2, 0)[1:]
    sample = torch.arange(len(truth)).repeat_interleave(2)[1:]
    after = (sample[1:] == sample[:-1]) & (sample[1:] % 20 == 0)
    after = torch.cat((torch.zeros(1, dtype=torch.bool), after))[:, None]
    mean = twice + torch.where(after, 0.0, 0.5) * deviation
    found = {"mean": mean, "deviation": torch.where(after, 0.5, 1.0) * deviation, "member": torch.tensor([1])}
    return {f"ukf/perturbed_sawtooth_{key}": value for key, value in found.items()}


def write(folder: Path, told: Results, kept: dict[str, Tensor] | None, config: dict | None) -> Path:
    folder.mkdir(parents=True)
    (folder / FILE).write_text(json.dumps(encoded(told)))
    if kept is not None:
        save_file(
            {key: value.contiguous() for key, value in kept.items()}, folder / "predictions.safetensors"
        )
    if config is not None:
        (folder / "config.yaml").write_text(yaml.safe_dump({"system": config}))
    return folder


def run(folder: Path, system: System, model: str, seed: int = 7) -> Path:
    """A finished run in `folder/MODEL_SEED`."""
    constants = {key: list(v) if isinstance(v, tuple) else v for key, v in asdict(system).items()}
    config = {"_target_": f"ahnn.systems.{type(system).__name__}", **constants}
    told = results(system.space, model, seed)
    return write(folder / f"{model}_{seed}", told, arrays(system, model, seed), config)
