"""Interacting models compared with individual filters on satellites that thrust for ten minutes.

    python benchmarks/bench_manoeuvres.py [SEEDS]

Twenty satellites near 1,000 km for three hours, a position of 100 m every minute, the exact flow. After an
hour and a half each gains 5 m/s per minute for ten minutes, along its velocity, unknown to the filters. Root
mean square errors of positions, and the probability of the mode with manoeuvres; medians of the seeds, and
their range.
"""

from __future__ import annotations

import sys
from statistics import median
from typing import Any

import torch
from timing import markdown, settle
from torch import Tensor

from ahnn.estimation import initial_belief
from ahnn.estimation.estimator import Estimator
from ahnn.measurements import Position
from ahnn.systems import Molniya, exact_flow
from ahnn_plugins.imm import InteractingModels, MixtureState, MotionMode
from ahnn_plugins.ukf import UnscentedKalmanFilter

MEMBERS, STEPS, DT, SD, THRUST = 20, 180, 60.0, 0.1, 5e-3
BURN = range(90, 100)
PHASES = {"before": slice(30, 90), "during": slice(91, 100), "after": slice(110, 180)}
QUIET = (1e-6,) * 3 + (1e-8,) * 3
"""Standard deviations of the process noise of a step in km and km/s: only a model's last digits."""
NOISY = (1e-3,) * 3 + (THRUST,) * 3
ADDED = [sd / DT**0.5 for sd in NOISY]
"""The same as white noise, after one second."""
SYSTEM = Molniya(name="low", dt=DT, steps=STEPS, altitude=(900.0, 1100.0), eccentricity=(0.001, 0.01))
MODES = InteractingModels(UnscentedKalmanFilter(), (MotionMode(), MotionMode(added=ADDED)), (7200.0, 600.0))
FILTERS: dict[str, tuple[Estimator[Any], tuple[float, ...]]] = {
    "ukf, quiet": (UnscentedKalmanFilter(), QUIET),
    "ukf, thrust noise": (UnscentedKalmanFilter(), NOISY),
    "imm, both modes": (MODES, QUIET),
}


def truth(seed: int) -> Tensor:
    """Return states (B, T + 1, 6) of satellites that thrust."""
    flow, x = exact_flow(SYSTEM), SYSTEM.initial_states(MEMBERS, torch.Generator().manual_seed(seed))
    states = [x]
    for k in range(STEPS):
        x = flow(x, DT)
        v = x[:, 3:]
        along = THRUST * v / v.norm(dim=-1, keepdim=True)
        x = torch.cat((x[:, :3], v + along), -1) if k in BURN else x
        states.append(x)
    return torch.stack(states, 1)


def figures(estimator: Estimator[Any], sds: tuple[float, ...], states: Tensor, seed: int) -> list[float]:
    """Return errors in the phases, probabilities there, and the log-likelihood of a number."""
    generator = torch.Generator().manual_seed(1000 + seed)
    rows = states[:, 1:, :3] + SD * torch.randn(MEMBERS, STEPS, 3, generator=generator, dtype=torch.float64)
    start = torch.tensor([1.0] * 3 + [1e-3] * 3, dtype=torch.float64)
    wrong = start * torch.randn(MEMBERS, 6, generator=generator, dtype=torch.float64)
    flow, q = exact_flow(SYSTEM), torch.diag(torch.tensor(sds, dtype=torch.float64) ** 2)
    state = estimator.start(initial_belief(states[:, 0] + wrong, torch.diag(start**2)))
    errors, modes = [], []
    for k in range(STEPS):
        state = estimator.predict(state, flow, DT, q)
        state, _ = estimator.update(state, rows[:, k], Position(), SD**2 * torch.eye(3))
        errors.append((state.moments.mean - states[:, k + 1])[:, :3].square().sum(-1))
        known = isinstance(state, MixtureState)
        modes.append(state.probabilities[:, 1].mean() if known else torch.tensor(torch.nan))
    found = [float(torch.stack(errors)[part].mean().sqrt()) for part in PHASES.values()]
    found += [float(torch.stack(modes)[part].mean()) for part in PHASES.values()]
    return [*found, float(state.log_likelihood.sum() / rows.numel())]


def shown(values: list[float]) -> str:
    """Return the median and the range of numbers; "" if a filter has none."""
    digits = (f"{value:.2g}" for value in (median(values), min(values), max(values)))
    return "" if values[0] != values[0] else "{} ({} to {})".format(*digits)


def main(seeds: int = 5) -> None:
    """Print the table."""
    settle()
    torch.set_grad_enabled(False)
    found: dict[str, list[list[float]]] = {name: [] for name in FILTERS}
    for seed in range(seeds):
        states = truth(seed)
        for name, chosen in FILTERS.items():
            found[name].append(figures(*chosen, states, seed))
    kinds = ("error [km]", "manoeuvre probability")
    heads = ["filter", *(f"{kind} {phase}" for kind in kinds for phase in PHASES)]
    rows = [[name, *(shown([*v]) for v in zip(*found[name], strict=True))] for name in found]
    print(markdown([*heads, "log-likelihood"], rows))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
