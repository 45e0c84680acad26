"""A training on measurements from start to end on a simulated device, beside the same one on the CPU."""

from __future__ import annotations

import pytest
import torch
from helpers import close
from hydra import compose, initialize_config_dir
from simulated_device import DEVICE, simulated_device

from ahnn.cli import prepare
from ahnn.dynamics import recorded_flow
from ahnn.jobs.fitting import fit
from ahnn.models import module
from ahnn.paths import conf_dir
from ahnn.training.weak import WeakProblem

SHORT = [
    "experiment=spring_noisy",
    "budget=smoke",
    "plugins=none",
    "logger=none",
    "loss.stages=[[relative,0.5],[weak,1.0]]",
    "trainer.max_epochs=2",
    "trainer.accelerator=cpu",
    "data.trajectories=20",
    "data.windows_per_epoch=60",
    "data.batch_size=20",
    "data.val_windows=3",
    "model.network.width=8",
    "system.steps=60",
]


def trained(folder):
    """Weights and validation loss of a training without its closing stage."""
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        prepared = prepare.prepare(compose("train", [*SHORT, f"folder={folder}"]))
    fit(prepared)
    best = torch.load(folder / "checkpoints" / "best.ckpt", weights_only=True)["state_dict"]
    return best, float(prepared.trainer.callback_metrics["val/loss"])


@pytest.mark.slow
def test_a_training_ends_as_on_the_cpu(tmp_path, monkeypatch):
    """Lightning has no such accelerator: its strategy for one device gets the simulated one."""
    build, equations, seen = prepare.build_trainer, WeakProblem.equations, set()

    def on_device(*arguments):
        trainer = build(*arguments)
        trainer.strategy._root_device = DEVICE
        trainer.accelerator.setup_device = lambda _: None  # that of the CPU refuses other devices
        return trainer

    def noted(problem, theta, sizes):
        seen.add((theta.device, problem.values.device))
        return equations(problem, theta, sizes)

    weights, loss = trained(tmp_path / "cpu")
    monkeypatch.setattr(prepare, "build_trainer", on_device)
    monkeypatch.setattr(WeakProblem, "equations", noted)
    monkeypatch.setattr(module, "DEVICES", (DEVICE.type,))
    monkeypatch.setattr(recorded_flow, "is_fixed", lambda _: False)  # dispatch modes cannot be traced
    with simulated_device():
        there, found = trained(tmp_path / "simulated")
    assert seen == {(DEVICE, DEVICE)}
    assert found == pytest.approx(loss, rel=1e-3)
    for name, value in weights.items():
        close(there[name], value, 1e-3)
