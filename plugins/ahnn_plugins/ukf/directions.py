"""The few directions of learned parameters that matter to a filter, of all in which they are uncertain.

What is left out makes a filter overconfident. Where parameters are off by L eta, eta ~ N(0, I), and a
filter does not learn them but counts them in its covariance P, its error is S eta beside what start and
noise leave (the consider filter of Schmidt; Bierman 1977, Factorization Methods for Discrete Sequential
Estimation, chapter 8): S moves with the flow, P = P' + S S^T gives the gain K, and an update leaves (I - K
H) S. The mean of e^T P^-1 e is D, of which each column of S has its squared length in units of P. So
directions are weighed by these: by what a filter cannot tell from measurements, and not by where a
prediction without any ends up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import NamedTuple, cast

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import Dynamics, HasField
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.dynamics.variations import own_jacobians
from ahnn.estimation.scenario import Setting
from ahnn.jacobians import pointwise_jacobian
from ahnn.measurements import observe
from ahnn.shooting.paths import Steps, path, sensitivities, transitions

SAMPLES = 100
"""Samples of a path at which directions are weighed, at least where it is as long."""
LEFT_OUT = 0.01
"""What directions that are left out may add to the NEES at any time, as a fraction of D."""
LEAST = 1e-9
"""Added to a correlation matrix, which rounding may leave singular."""


class Chosen(NamedTuple):
    """Directions of the parameters for a filter.

    Attributes:
        directions: S, (P, K), the most important first, the largest part of each positive.
        left_out: what those that are left out add to the NEES at most, along the paths that were looked at.
    """

    directions: Tensor
    left_out: float


def filtered_directions(
    dynamics: Dynamics, spread: Tensor, start: Tensor, dt: float, steps: int, setting: Setting, most: int
) -> Chosen:
    """Return as few directions of the parameters as leave out next to nothing.

    Args:
        dynamics: with a field, float64.
        spread: L, shape (P, R); L L^T is the covariance of the parameters.
        start: (B, D) of the paths that are filtered.
        dt: length of a step.
        steps: of each path.
        setting: measurements and P0.
        most: directions, at most.
    """
    lengths = start.new_full((len(start), steps), dt)
    states = path(dynamics.increment, start, lengths)
    sound = states.isfinite().flatten(1).all(1)
    states, lengths = states[sound], lengths[sound]
    theta = parameters_to_vector(dynamics.parameters()).detach()
    forcing = field_jacobian(cast(HasField, dynamics))

    def driven(part: slice) -> Tensor:
        return forcing(theta, states[:, part]) @ spread.float()

    arc = _Arc(states, own_jacobians(dynamics)(states[:, :-1], lengths), lengths, driven)
    rows = torch.cat([*_whitened_rows(arc, setting, dt, spread.shape[1])])
    axes = torch.linalg.eigh(torch.einsum("bdi,bdj->ij", rows, rows)).eigenvectors.flip(1)
    beyond = (rows @ axes).square().sum(1).flip(1).cumsum(1).flip(1).amax(0).tolist()
    count = min(max(1, sum(left > LEFT_OUT * rows.shape[1] for left in beyond)), most)
    directions = spread @ axes[:, :count].to(spread)
    # A saved filter goes on with the same signs, on whatever processor.
    signs = directions.gather(0, directions.abs().argmax(0, keepdim=True)).sign()
    return Chosen(directions * signs, [*beyond, 0.0][count])


class _Arc(NamedTuple):
    """Paths and what moves with them.

    Attributes:
        states: (B, N + 1, D).
        jacobians: of the steps, (B, N, D, D), float32.
        lengths: of the steps, (B, N).
        driven: part of the samples -> what the columns of L add to the field there, (B, n, ., R), float32.
    """

    states: Tensor
    jacobians: Tensor
    lengths: Tensor
    driven: Callable[[slice], Tensor]


def _whitened_rows(arc: _Arc, setting: Setting, dt: float, columns: int) -> Iterator[Tensor]:
    """Yield P^-1/2 S of paths at some times, (M, D, R): what each column adds to the NEES is its square."""
    batch, samples, size = arc.states.shape
    steps, apart = samples - 1, max(1, (samples - 1) // SAMPLES)
    updates = [k for k in setting.updates if k <= steps]
    own = setting.start_covariance.to(arc.states).expand(batch, -1, -1)
    moved = arc.jacobians.new_zeros(batch, size, columns)
    for begin, end in pairwise(sorted({0, *updates, steps})):
        ends = torch.tensor([*range(apart, end - begin, apart), end - begin])
        span, jacobians = Steps(arc.lengths[:, begin:end], ends), arc.jacobians[:, begin:end]
        on_the_way = sensitivities(jacobians, arc.driven(slice(begin, end + 1)), span, moved)
        carried = transitions(jacobians)[:, ends].to(own)
        before = carried @ own.unsqueeze(1) @ carried.mT
        yield _whitened(on_the_way.to(own), before).flatten(0, 1).to(moved)
        moved, own = on_the_way[:, -1], before[:, -1]
        if end in updates:
            moved, own = _updated(moved, own, arc.states[:, end], end * dt, setting)


def _whitened(moved: Tensor, own: Tensor) -> Tensor:
    """Return P^-1/2 S, with P = P' + S S^T, of S (..., D, R) and P' (..., D, D)."""
    total = own + moved @ moved.mT
    unit = total.diagonal(dim1=-2, dim2=-1).rsqrt().unsqueeze(-1)
    root = torch.linalg.cholesky(unit * total * unit.mT + LEAST * torch.eye(own.shape[-1]).to(own))
    return torch.linalg.solve_triangular(root, unit * moved, upper=False)


def _updated(
    moved: Tensor, own: Tensor, state: Tensor, time: float, setting: Setting
) -> tuple[Tensor, Tensor]:
    """Return S and P' after an update; what is out of view tells nothing."""
    sensor, noise, s = setting.measurement, setting.measurement_noise.to(own), moved.to(own)
    rows = pointwise_jacobian(lambda x: sensor(x, time), state)
    rows = rows.masked_fill(observe(sensor, state, time).isnan().unsqueeze(-1), 0.0)
    seen = rows @ (own + s @ s.mT)
    gain = torch.linalg.solve(seen @ rows.mT + noise, seen).mT
    left = torch.eye(own.shape[-1]).to(own) - gain @ rows
    return (left @ s).to(moved), left @ own @ left.mT + gain @ noise @ gain.mT
