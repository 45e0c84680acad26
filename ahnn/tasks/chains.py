"""Chains of pendulums from 800 chunks of five states (Finzi, Wang & Wilson 2020)."""

from __future__ import annotations

from functools import partial

import numpy as np
import torch
from torch import Tensor

from ahnn.rollouts import rollout
from ahnn.systems import ChainPendulum
from ahnn.systems.truth import exact_flow
from ahnn.tasks.definition import Draw, FieldTask, Predict, numbers, states
from ahnn.types import Trajectories

SOURCE = "mfinzi/constrained-hamiltonian-neural-networks, MIT; Finzi, Wang & Wilson 2020, arXiv:2010.13581"
CHUNKS, SAMPLES, STEP = 800, 5, 0.03
LATEST = 300
"""Maximum end of a trajectory chunk, in steps after its start."""
TESTED, LONG = 200, 100
LONGER = ("network=wide_128", "trainer.max_epochs=200")


def points(q: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Return the links as vectors (..., n, 2) from angles (..., n)."""
    return lengths[:, None] * np.stack((np.sin(q), -np.cos(q)), axis=-1)


def begin(count: int, system: ChainPendulum, generator: np.random.Generator) -> Tensor:
    """Return starts (count, 2n): normal angles, link ends displaced by 0.2 m, random velocities.

    Displaced ends are projected onto the rods link by link, and velocities by least squares.
    """
    n, lengths = system.links, np.array(system.lengths)
    q, omega = generator.standard_normal((2, count, n))
    links = points(q, lengths)
    ends = links.cumsum(1) + 0.2 * generator.standard_normal((count, n, 2))
    moved = np.diff(np.concatenate((np.zeros((count, 1, 2)), ends), axis=1), axis=1)
    before = np.stack((-links[..., 1], links[..., 0]), axis=-1) * omega[..., None]
    velocity = 0.5 * before.cumsum(1) + 0.4 * generator.standard_normal((count, n, 2))
    q = np.arctan2(moved[..., 0], -moved[..., 1])
    links = points(q, lengths)
    across = np.stack((-links[..., 1], links[..., 0]), axis=-1)  # d(link)/dq
    by = np.tril(np.ones((n, n)))[None, :, None, :] * across.transpose(0, 2, 1)[:, None]  # (count, n, 2, n)
    rates = np.stack(
        [
            np.linalg.lstsq(a.reshape(2 * n, n), v.reshape(2 * n), rcond=None)[0]
            for a, v in zip(by, velocity, strict=True)
        ]
    )
    return system.states(states(q), states(rates))


def seen(x: Tensor, system: ChainPendulum) -> Tensor:
    """Return positions and velocities of the ends of the links, (..., 4n), at states (..., 2n)."""
    q, p = x.chunk(2, dim=-1)
    v = torch.linalg.solve(system.mass_matrix(q), p.unsqueeze(-1)).squeeze(-1)
    lengths = system.numbers(system.lengths, x)
    link = lengths[:, None] * torch.stack((q.sin(), -q.cos()), dim=-1)
    rate = (lengths * v)[..., None] * torch.stack((q.cos(), q.sin()), dim=-1)
    return torch.cat((link.cumsum(-2).flatten(-2), rate.cumsum(-2).flatten(-2)), dim=-1)


def draw(k: int, *, links: int) -> Draw:
    """Draw segments, at random times, from trajectories of a chain with random masses and lengths."""
    generator = numbers(k)
    masses, lengths = generator.uniform(0.6, 1.4, (2, links))
    system = ChainPendulum(
        name="chain",
        links=links,
        masses=masses.tolist(),
        lengths=lengths.tolist(),
        gravity=1.0,
        dt=STEP,
        steps=LATEST,
    )
    flow = exact_flow(system)
    count = CHUNKS + CHUNKS // 4
    with torch.no_grad():
        paths = rollout(flow, begin(count, system, generator), STEP, LATEST + 1)
        first = torch.as_tensor(generator.integers(0, LATEST + 2 - SAMPLES, count))
        chunks = paths[torch.arange(count)[:, None], first[:, None] + torch.arange(SAMPLES)]
        starts = begin(TESTED, system, numbers(k, 1))
        truth = seen(rollout(flow, starts, STEP, LONG + 1), system)

    def score(predict: Predict) -> float:
        found = seen(predict(starts, LONG, STEP), system)[:, 1:]
        right = truth[:, 1:]
        return float(((found - right).norm(dim=-1) / (found + right).norm(dim=-1)).log().mean().exp())

    times = torch.arange(SAMPLES, dtype=torch.float64) * STEP
    return Draw(Trajectories(chunks, times), system.space, (0.8, 0.15, 0.05), score)


def chain(links: int, floor: float, **published: float) -> FieldTask:
    """Build the task of a chain with a given number of links."""
    return FieldTask(
        f"chain of {links} pendulums from {CHUNKS} chunks of {SAMPLES} states, {STEP:g} apart",
        SOURCE,
        "|x - y| / |x + y| of positions and velocities, geometric mean over 3 units of time",
        "given momenta; the published models use velocities",
        published,
        {"mass_matrix": ("model=hnn", "hamiltonian=mass_matrix", "inputs=angles", "loss=recursive", *LONGER)},
        partial(draw, links=links),
        floor,
    )
