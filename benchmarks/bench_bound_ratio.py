"""Errors over their bound for hundreds of data sets of the pendulum, each with its own starts and noise.

    python benchmarks/bench_bound_ratio.py RUN --draws 240

RUN is the folder of a training with experiment=pendulum_angles. One training takes minutes, and its ratio of
error and bound is one number that scatters widely. Here the estimate on another data set takes a second: near
the truth, angles are linear in the error of the force, a function of the angle alone. So a data set counts by
two things, the information about that function at the nodes of a grid, and the noise projected on it. Both
follow from sensitivities that are interpolated between starts. With the derivatives of the force by the
weights of RUN and its prior, the optimum is one linear step, as in function space.

Starts and noise are those that a training with the same data.seed has. A line for each draw: the error over
the bound, the middle 95 % of that ratio by the spectrum of this draw, and the rank of the ratio in it. Where
the bound is right, ranks are uniform and the rms of the ratios is 1.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple, cast

import torch
from omegaconf import OmegaConf
from scipy.stats import kstest
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from ahnn import load
from ahnn.cli.parts import build_sensor, build_source
from ahnn.data.sensor import Sensor
from ahnn.data.splits import split_sizes
from ahnn.dynamics import HasField
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.evaluation.independent_directions import ratio_draws, ratio_interval
from ahnn.runs import Run
from ahnn.systems import Pendulum
from ahnn.training.evidence import Prior, posterior_factor
from ahnn.types import Trajectories

NODES, CELLS, STEPS = 120, 1001, 200
"""Nodes of the force, starts between which sensitivities are interpolated, and steps of a swing."""


class Swings(NamedTuple):
    """Sensitivities at `CELLS` starts.

    Attributes:
        measured: of measured angles in standard deviations to the force at the nodes, starts eliminated,
            (CELLS, K + 1, NODES).
        information: their products, (CELLS, NODES, NODES).
        predicted: mean products of those of angles from a known start, (CELLS, NODES, NODES).
    """

    measured: Tensor
    information: Tensor
    predicted: Tensor


def linear(values: Tensor, grid: Tensor) -> tuple[Tensor, Tensor]:
    """Return index and weight of linear interpolation on an even grid."""
    place = (values - grid[0]) / (grid[1] - grid[0])
    index = place.floor().long().clamp(0, len(grid) - 2)
    return index, place - index


def responses(system: Pendulum, starts: Tensor, nodes: Tensor, duration: float) -> Tensor:
    """Return d angle / d (force at nodes, start, momentum), (B, STEPS + 1, NODES + 2), by RK4."""
    inertia, dt = system.inertia, duration / STEPS
    moved = torch.zeros(len(starts), 2, len(nodes) + 2, dtype=torch.float64)
    moved[:, 0, -2] = moved[:, 1, -1] = 1
    state, found = (starts, torch.zeros_like(starts), moved), [moved[:, 0]]

    def rate(now: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        q, p, moved = now
        stiffness = -system.mass * system.gravity * system.length * q.cos()
        index, weight = linear(q, nodes)
        pull = stiffness[:, None] * moved[:, 0]
        pull = pull.scatter_add(1, index[:, None], (1 - weight)[:, None])
        pull = pull.scatter_add(1, index[:, None] + 1, weight[:, None])
        return p / inertia, system.force(q), torch.stack((moved[:, 1] / inertia, pull), dim=1)

    def after(slopes: tuple[Tensor, ...], share: float) -> tuple[Tensor, ...]:
        return tuple(x + share * dt * k for x, k in zip(state, slopes, strict=True))

    for _ in range(STEPS):
        one = rate(state)
        two = rate(after(one, 0.5))
        three = rate(after(two, 0.5))
        four = rate(after(three, 1.0))
        parts = zip(state, one, two, three, four, strict=True)
        state = tuple(x + dt / 6 * (a + 2 * b + 2 * c + d) for x, a, b, c, d in parts)
        found.append(state[2][:, 0])
    return torch.stack(found, dim=1)


def swings_of(system: Pendulum, sensor: Sensor, nodes: Tensor, starts: Tensor) -> Swings:
    """Compute the sensitivities at evenly spaced starts."""
    measured, predicted = [], []
    every = STEPS * sensor.every // system.steps
    for some in starts.split(250):
        moved = responses(system, some, nodes, system.steps * system.dt)
        rows, known = moved[:, ::every] / sensor.deviations, moved[..., :-2]
        basis, rows = torch.linalg.qr(rows[..., -2:]).Q, rows[..., :-2]
        measured.append(rows - basis @ (basis.mT @ rows))
        predicted.append(known.mT @ known / known.shape[1])
    rows = torch.cat(measured)
    return Swings(rows, rows.mT @ rows, torch.cat(predicted))


def prior_of(run: Run) -> Prior:
    """Return the prior at the end of a training."""
    assert run.uncertainty is not None
    named = dict(run.trained.named_parameters())
    strengths = run.uncertainty.about["strengths"]
    return Prior(
        torch.tensor([strengths[name] for name in named]).double(), [p.numel() for p in named.values()]
    )


def ratio(run: Run, swings: Swings, nodes: Tensor, starts: Tensor, seed: int) -> tuple[float, Tensor]:
    """Return error over bound of a data set, and W^T W of the bound."""
    cfg = OmegaConf.create(run.config)
    cfg.data.seed = seed
    source = build_source(cfg)
    system, sensor = source.truth, build_sensor(cfg, source)
    assert isinstance(system, Pendulum)
    assert sensor is not None
    first = system.initial_states(cfg.data.trajectories, torch.Generator().manual_seed(seed))[:, 0]
    train, _, test = split_sizes(len(first), list(cfg.data.split))
    still = torch.zeros(train, system.steps + 1, 2, dtype=torch.float64)
    noise = sensor.measure(Trajectories(still, still[..., 0]), 0).values[..., 0] / sensor.deviations

    def spread(rows: Tensor, values: Tensor) -> Tensor:
        """Return values (B, ...) of trajectories distributed to the starts on either side."""
        index, weight = linear(rows, starts)
        total = torch.zeros(len(starts), *values.shape[1:], dtype=torch.float64)
        shape = (-1, *[1] * (values.ndim - 1))
        total.index_add_(0, index, (1 - weight).view(shape) * values)
        return total.index_add_(0, index + 1, weight.view(shape) * values)

    one = torch.ones_like(first)
    information = torch.einsum("g,gnm->nm", spread(first[:train], one[:train]), swings.information)
    pull = torch.einsum("gtn,gt->n", swings.measured, spread(first[:train], noise))
    predicted = torch.einsum("g,gnm->nm", spread(first[-test:], one[-test:]), swings.predicted)
    states = torch.stack((nodes, torch.zeros_like(nodes)), dim=-1)
    theta = parameters_to_vector(run.trained.parameters()).detach()
    learned = cast(HasField, run.trained)
    slopes = field_jacobian(learned, torch.float64)(theta, states)[:, -1]
    off = learned.field(states)[:, 1].detach() - system.force(nodes)
    matrix = slopes.mT @ information @ slopes
    prior = prior_of(run)
    factor = posterior_factor(matrix, prior)
    gradient = slopes.mT @ (information @ off - pull) + prior.precision * theta
    off, moved = off - slopes @ (factor @ (factor.mT @ gradient)), slopes @ factor
    bound = moved.mT @ predicted @ moved
    return float((off @ predicted @ off / bound.diagonal().sum()).sqrt()), bound


@torch.no_grad()
def main() -> None:
    """Print a line for each draw, and their distribution."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path)
    parser.add_argument("--draws", type=int, default=240)
    parser.add_argument("--seeds", type=int, nargs="*", help="of data.seed, instead of 1, 2, ...")
    args = parser.parse_args()
    run = load(args.run)
    cfg = OmegaConf.create(run.config)
    source = build_source(cfg)
    system, sensor = source.truth, build_sensor(cfg, source)
    assert isinstance(system, Pendulum)
    assert sensor is not None
    low, high = system.q0
    edge = 0.015 * (high - low) / 2
    nodes = torch.linspace(low - edge, high + edge, NODES, dtype=torch.float64)
    starts = torch.linspace(low, high, CELLS, dtype=torch.float64)
    swings, found = swings_of(system, sensor, nodes, starts), list[tuple[float, float]]()
    for seed in args.seeds or range(1, args.draws + 1):
        own, bound = ratio(run, swings, nodes, starts, seed)
        rank = float((ratio_draws(bound) < own).double().mean())
        found.append((own, rank))
        ends = ratio_interval(bound)
        print(f"{seed}: {own:.2f} of the bound ({ends[0]:.2f} to {ends[1]:.2f}), rank {rank:.2f}", flush=True)
    ratios, ranks = torch.tensor(found, dtype=torch.float64).T
    outside = int(((ranks < 0.025) | (ranks > 0.975)).sum())
    below = [f"{100 * float((ratios < at).double().mean()):.1f} % below {at}" for at in (0.72, 0.6, 0.5)]
    print(
        f"{len(ratios)} draws: {float(ratios.square().mean().sqrt()):.3f} of the bound (rms), median", end=" "
    )
    print(f"{float(ratios.median()):.2f}; {', '.join(below)}; {outside} outside their interval;", end=" ")
    print(f"ranks uniform with p = {kstest(ranks, 'uniform').pvalue:.2g}")


if __name__ == "__main__":
    main()
