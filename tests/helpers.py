"""What many tests need: a comparison relative to size, small data sets and small models."""

from __future__ import annotations

import dataclasses
import shutil
from functools import cache, partial
from pathlib import Path
from typing import Any

import torch
from hydra import compose, initialize_config_dir
from torch import Tensor

from ahnn.checkpoints import FORMAT, read_weights, write_weights
from ahnn.cli.build import plain_config
from ahnn.cli.parts import SENSOR, SIMULATION
from ahnn.data import Simulated
from ahnn.data.datamodule import WindowDataModule
from ahnn.models import AHNN, MLP, NODE, AbstractModel, Optimisation
from ahnn.paths import conf_dir
from ahnn.pretrained import shipped
from ahnn.stored import about_space
from ahnn.systems import HenonHeiles, Kepler, MassSpring, Molniya, Pendulum, System
from ahnn.types import Window

SPRING = MassSpring(name="mass_spring", dt=0.01, steps=1000)
MOLNIYA = Molniya(name="molniya", dt=60.0, steps=1440)
SYSTEMS: dict[str, System] = {
    system.name: system
    for system in (
        SPRING,
        MassSpring(name="heavy_spring", dt=0.01, steps=1000, mass=3.0, stiffness=0.7),
        MOLNIYA,
        Molniya(name="heavy_molniya", dt=60.0, steps=1440, mass=2.5),
        Kepler(name="kepler", dt=0.05, steps=1000),
        Kepler(name="heavy_kepler", dt=0.05, steps=1000, mass=3.0),
        Pendulum(name="pendulum", dt=0.01, steps=1000, length=0.6, mass=2.0),
        HenonHeiles(name="henon_heiles", dt=0.05, steps=1000),
        HenonHeiles(name="heavy_henon_heiles", dt=0.05, steps=1000, mass=2.0),
    )
}
TINY = {"width": 6, "depth": 2, "activation": "gelu"}


def close(a: Tensor, b: Tensor, rtol: float) -> None:
    """Assert equal shapes and a largest difference of at most rtol times the largest entry of b."""
    assert a.shape == b.shape, f"shapes {tuple(a.shape)} and {tuple(b.shape)}"
    a, b = a.detach().double(), b.detach().double()
    assert bool(a.isfinite().all()), "not finite"
    size = float(b.abs().max())
    worst = float((a - b).abs().max())
    assert worst <= rtol * size, f"largest difference {worst:.3e} of size {size:.3e}, allowed {rtol:.1e}"


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def random_states(system: System, count: int, seed: int) -> Tensor:
    """States the system can be in: initial states turned to random phases by a crude integration."""
    x = system.initial_states(count, generator(seed))
    kick = torch.rand(count, 1, generator=generator(seed + 1), dtype=torch.float64)
    for _ in range(20):
        q, p = x.chunk(2, dim=-1)
        p = p + kick * system.dt * system.force(q)
        x = torch.cat((q + kick * system.dt * system.velocity(p), p), dim=-1)
    return x


@cache
def defaults(model: str) -> dict[str, Any]:
    """The configuration of a model, composed and resolved, as plain values."""
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = compose("train", [f"model={model}", "folder=."])
    return {key: plain_config(cfg[key]) for key in ("data", "model", "loss")}


def data_module(system: System, folder: str, **changes: Any) -> WindowDataModule:
    """A small DataModule; `steps` shortens the trajectories."""
    system = dataclasses.replace(system, steps=changes.pop("steps", 40))
    options = dict(defaults("hnn")["data"])
    del options["_target_"]
    options |= {"trajectories": 10, "split": [0.6, 0.2, 0.2], "window": 3, "batch_size": 32}
    options |= {"windows_per_epoch": None, "val_windows": None, "precision": 64, "cache": folder} | changes
    simulation = {name: options.pop(name) for name in SIMULATION}
    for name in SENSOR:
        options.pop(name)
    return WindowDataModule(Simulated(system, **simulation), **options)


def build_model(name: str, system: System, **changes: Any) -> AbstractModel:
    """A tiny model of a kind: mlp, mlp_residual, node, hnn_derivative, or the structure of an AHNN."""
    kind = name if name in ("mlp", "node", "hnn_derivative") else "hnn"
    options = dict(defaults("mlp" if name == "mlp_residual" else kind)["model"])
    target = {"MLP": MLP, "NODE": NODE, "AHNN": AHNN}[options.pop("_target_").split(".")[-1]]
    options |= {"scaling": "block", "network": TINY, "window": 3}
    if name == "mlp_residual":
        options["residual"] = True
    if target is AHNN:
        structure = name if name in ("separable", "mechanical", "central_body") else "generic"
        options |= {"hamiltonian": structure, "inertia": system.inertia}
    derivative = 1.0 if name == "hnn_derivative" else 0.0
    options["loss"] = options["loss"] | {"derivative": derivative} | changes.pop("loss", {})
    return target(system.dof, **(options | changes))


def ready_model(name: str, data: WindowDataModule, seed: int = 0, **changes: Any) -> AbstractModel:
    """A tiny model in the precision of its data, calibrated, with AdamW."""
    torch.manual_seed(seed)
    model = build_model(name, data.source.truth, **({"window": data.window} | changes)).to(data.dtype)
    data.require_span(model.curriculum.span)
    model.calibrate(data.statistics())
    space = data.source.space
    about = {"format": FORMAT, "space": about_space(space), "dt": data.statistics().dt}
    model.train_by(Optimisation(partial(torch.optim.AdamW, lr=1e-2), None), about)
    return model


def batch_of(data: WindowDataModule, count: int = 32) -> Window:
    windows = data.val_dataloader().windows
    return windows.gather(torch.arange(count) * len(windows) // count)


def framed(folder: Path, frame: str) -> Path:
    """A copy of the mechanical model that says in which frame, about what and from when its data were."""
    shutil.copytree(shipped("molniya_mechanical"), folder)
    weights = read_weights(folder / "weights.safetensors")
    weights.about["space"]["frame"] = frame
    (folder / "weights.safetensors").unlink()
    write_weights(folder / "weights.safetensors", weights)
    return folder
