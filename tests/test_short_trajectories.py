"""Trajectories as long as one window: pairs (x, x') and other short recordings."""

from __future__ import annotations

import pytest
import torch
from entry import untouched

import ahnn
from ahnn.checkpoints import read_checkpoint

SPACE = ahnn.Space("pairs", ("x", "vx"), ahnn.Units("s", "m", "m/s", "m²/s²"))
TINY = [
    *(
        "data.split=[0.6,0.2,0.2]",
        "data.windows_per_epoch=null",
        "data.val_windows=null",
        "data.batch_size=32",
    ),
    *("model.network.width=4", "trainer.max_epochs=2", "trainer.accelerator=cpu", "logger=none"),
    *("plugins=none", "loss.derivative=0", "budget=smoke"),
]


def arcs(samples: int) -> ahnn.Trajectories:
    """Exact trajectories of x'' = -x from 60 random states, 0.1 s between samples."""
    start = torch.randn(60, 1, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    times = 0.1 * torch.arange(samples, dtype=torch.float64)
    cos, sin = times.cos(), times.sin()
    x, v = start[..., 0], start[..., 1]
    return ahnn.Trajectories(torch.stack((x * cos + v * sin, v * cos - x * sin), dim=-1), times)


@pytest.mark.parametrize("samples", [2, 3])
def test_trajectories_of_one_window_train_and_rollouts_select_the_weights(tmp_path, samples):
    with untouched():
        run = ahnn.fit(arcs(samples), SPACE, [*TINY, f"window={samples - 1}"], folder=tmp_path / "run")
    states = read_checkpoint(tmp_path / "run" / "checkpoints" / "last.ckpt")["callbacks"]
    best, rollout = (
        next(v for k, v in states.items() if k.startswith(name))
        for name in ("BestPoint", "ValidationRollout")
    )
    assert 0.0 < best["best"] < 1.000001 * rollout["latest"] < 10.0
    assert run.rollout(torch.tensor([[1.0, 0.0]]), steps=1).shape == (1, 2, 2)
