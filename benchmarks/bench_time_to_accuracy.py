"""Time to the paper's AHNN5 accuracy: the laptop budget beside the plain training loop, in one run.

    python benchmarks/bench_time_to_accuracy.py [cap]

The plain loop: one-step loss, AdamW at batch 256 from a per-sample DataLoader, gradient by autograd, float32,
residuals in units of the state. Both learn the same structure from the same trajectories and are judged on
25 validation trajectories, whose rollouts are not counted in the time. The plain loop is stopped at `cap`
times our time (default 12), so a time printed with ">" is a lower bound.
"""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Iterator

import torch
from hydra import compose, initialize_config_dir
from timing import markdown, shown
from torch.utils.data import DataLoader, TensorDataset

from ahnn.cli.build import OmegaConf  # registers the resolvers of conf/
from ahnn.cli.prepare import prepare
from ahnn.integrators import INTEGRATORS
from ahnn.metrics import errors, rmse_norm
from ahnn.paths import conf_dir
from ahnn.rollouts import rollout
from ahnn.types import Window

TASKS = {
    "spring, generic": (["system=mass_spring"], 1.55e-4),
    "orbit, separable": (["experiment=molniya_separable"], 173.81),
}
UNITS = {"spring, generic": "m", "orbit, separable": "km"}
CHECKS = 24
"""Rollouts of the plain loop, spread evenly over its time."""
STRIDE = 5
"""Steps of the laptop budget between two rollouts."""


class PlainField(torch.nn.Module):
    """J grad H of a model's Hamiltonian with the gradient taken by autograd."""

    def __init__(self, hamiltonian: torch.nn.Module) -> None:
        super().__init__()
        self.hamiltonian = hamiltonian

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return dx/dt, shape (B, D)."""
        with torch.enable_grad():
            x = x.detach().requires_grad_() if not x.requires_grad else x
            energy = self.hamiltonian.energy(x).sum()
            dq, dp = torch.autograd.grad(energy, x, create_graph=self.training)[0].chunk(2, dim=-1)
        return torch.cat((dp, -dq), dim=-1)


def position_error(flow, truth: torch.Tensor, dt: float, dof: int) -> float:
    """Return the mean over trajectories of the rms position error of full rollouts."""
    prediction = rollout(flow, truth[:, 0], dt, truth.shape[1])
    return float(rmse_norm(errors(prediction, truth)[..., :dof]))


def ours(data, model, target: float) -> float:
    """Return the seconds of Levenberg-Marquardt on derivatives until the target is met."""
    optimizer = model.optimisation.optimizer(model.dynamics.parameters())
    truth, space = data.trajectories("val").states[:25], data.source.space
    dt = data.statistics().dt
    stream, spent = batches(data), 0.0
    while True:
        begin = time.perf_counter()
        for batch in itertools.islice(stream, STRIDE):
            model.stepper.step(model.objective, model.loss, model.dynamics, batch, optimizer)
        spent += time.perf_counter() - begin
        error = position_error(model.flow(), truth, dt, space.dof)
        print(f"  laptop budget {spent:7.1f} s  {error:.3g}", flush=True)
        if error <= target:
            return spent


def batches(data) -> Iterator[Window]:
    """Yield the training batches of one epoch after another, without end."""
    loader = data.train_dataloader()
    for epoch in itertools.count():
        loader.set_epoch(epoch)
        yield from loader


def plain(data, model, target: float, limit: float) -> float | None:
    """Return the seconds of the plain loop until the target is met, None beyond the limit."""
    model = model.float()
    field, rk4, dt = PlainField(model.dynamics.field), INTEGRATORS["rk4"], data.statistics().dt
    states = data.trajectories("train").states
    pairs = TensorDataset(states[:, :-1].flatten(0, 1).float(), states[:, 1:].flatten(0, 1).float())
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-3)
    scale = (states.flatten(0, 1).amax(0) - states.flatten(0, 1).amin(0)).float() / 2
    truth, dof = data.trajectories("val").states[:25], data.source.space.dof
    spent, due = 0.0, limit / CHECKS
    while True:
        begin = time.perf_counter()
        for x, y in DataLoader(pairs, batch_size=256, shuffle=True):
            optimizer.zero_grad()
            torch.nn.functional.huber_loss(rk4.step(field, x, dt) / scale, y / scale).backward()
            optimizer.step()
            if spent + time.perf_counter() - begin < due:
                continue
            spent, due = spent + time.perf_counter() - begin, due + limit / CHECKS
            error = position_error(model.flow(), truth, dt, dof)
            print(f"  plain loop    {spent:7.1f} s  {error:.3g}", flush=True)
            if error <= target or spent >= limit:
                return spent if error <= target else None
            begin = time.perf_counter()


def raced(cap: float) -> Iterator[tuple[str, float, float | None]]:
    """Yield each task, our seconds, and those of the plain loop or None beyond `cap` times ours."""
    for name, (overrides, target) in TASKS.items():
        print(f"{name}: position error {target} of the paper's AHNN5", flush=True)
        with initialize_config_dir(str(conf_dir()), version_base="1.3"):
            cfg = compose("train", [*overrides, "folder=."])
        OmegaConf.resolve(cfg)
        prepared, rival = prepare(cfg), prepare(cfg).model
        data, model = prepared.data, prepared.model
        for either in (model, rival):
            either.calibrate(data.statistics())
        model.configure_optimizers()  # which says how steps are taken
        fast = ours(data, model, target)
        yield name, fast, plain(data, rival, target, cap * fast)


def race(cap: float) -> str:
    """Return the table of both tasks; where the plain loop was stopped, its time is a lower bound."""
    lines = []
    for name, fast, slow in raced(cap):
        times = shown(fast), f"> {shown(cap * fast)}" if slow is None else shown(slow)
        beside = f"< {shown(1 / cap)}" if slow is None else shown(fast / slow)
        lines.append([f"{name}, {TASKS[name][1]:g} {UNITS[name]}", *times, beside])
    return markdown(("wall clock [s] to", "ahnn", "plain loop", "ahnn / plain loop"), lines)


def main() -> None:
    """Print the table."""
    torch.set_num_threads(1)
    print(race(float(sys.argv[1]) if len(sys.argv) > 1 else 12.0))


if __name__ == "__main__":
    main()
