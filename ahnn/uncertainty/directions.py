"""Selection of the uncertain parameter directions that are relevant to a filter.

Omitted directions make a filter overconfident. A consider filter (Schmidt; Bierman 1977, Factorization
Methods for Discrete Sequential Estimation, chapter 8) does not estimate parameters with errors L eta,
eta ~ N(0, I), but accounts for them in its covariance P. Its error e is S eta plus an error of covariance P'
due to the initial state and the noise. S is propagated by the flow, the gain K follows from P = P' + S S^T,
and an update replaces S by (I - K H) S. The mean of e^T P^-1 e is D; each column of S contributes its squared
length in units of P. Directions are ranked by these contributions, i.e. by how little the measurements
determine them, and not by their effect on pure predictions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple, cast

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import Dynamics, HasField
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.dynamics.variations import own_jacobians
from ahnn.errors import UserError
from ahnn.jacobians import pointwise_jacobian
from ahnn.measurements import Segment
from ahnn.shooting.path_sensitivities import Steps, path, sensitivities, steps_between, transitions

ARCS = 12
"""Approximate number of training trajectories for the ranking."""
MOST = 50
"""Maximum number of parameter directions used as filter states."""
SAMPLES = 100
"""Approximate number of times per path for the ranking."""
LEAST = 1e-9
"""Jitter added to correlation matrices, which rounding may make singular."""


class Watched(NamedTuple):
    """Paths of a filter.

    Attributes:
        start: initial states, (B, D).
        start_sd: (D,) standard deviations of the initial states.
        segment: times, pattern of measured values (NaN if not measured), and sensor; values are ignored.
    """

    start: Tensor
    start_sd: Tensor
    segment: Segment


class Chosen(NamedTuple):
    """Selected parameter directions for a filter.

    Attributes:
        directions: (P, K), in order of importance, with positive largest component.
        left_out: maximum contribution of the omitted directions to the NEES along the paths.
    """

    directions: Tensor
    left_out: float


@torch.no_grad()
def filtered_directions(
    dynamics: Dynamics,
    spread: Tensor,
    watched: Watched,
    most: int,
    enough: float = 0.0,
    learned: Dynamics | None = None,
) -> Chosen:
    """Return the parameter directions least observable by a filter from its measurements.

    Args:
        dynamics: float64 dynamics with a field, whose parameters are uncertain.
        spread: L, shape (P, R); L L^T is the covariance of the parameters.
        watched: paths of the filter; diverging paths are omitted.
        most: maximum number of directions.
        enough: tolerated NEES contribution of the omitted directions per state component; the fewest
            sufficient directions are returned.
        learned: dynamics of the paths; None: `dynamics`.

    Raises:
        UserError: all paths of the filter diverge.
    """
    steps = steps_between(watched.segment.times, watched.segment.instrument.longest)
    learned = learned or dynamics
    states = path(learned.increment, watched.start, steps.lengths)
    sound = states.isfinite().flatten(1).all(1)
    if not bool(sound.any()):
        message = (
            "process_noise: expected a model whose trajectories from the training states stay finite; "
            f"received one with {len(states)} trajectories that do not"
        )
        raise UserError(message)
    states, steps, segment = states[sound], steps.rows(sound), watched.segment.rows(sound)
    theta = parameters_to_vector(dynamics.parameters()).detach()
    forcing = field_jacobian(cast(HasField, dynamics))
    arc = _Arc(
        states,
        own_jacobians(learned)(states[:, :-1], steps.lengths),
        steps,
        lambda part: forcing(theta, states[:, part]) @ spread.float(),
    )
    rows = torch.cat([*_whitened_rows(arc, segment, watched.start_sd, spread.shape[1])])
    rows = rows[rows.isfinite().flatten(1).all(1)]  # chaotic motion may exceed single precision
    axes = torch.linalg.eigh(torch.einsum("bdi,bdj->ij", rows, rows)).eigenvectors.flip(1)
    beyond = (rows @ axes).square().sum(1).flip(1).cumsum(1).flip(1).amax(0).tolist()
    count = min(max(1, sum(left > enough * rows.shape[1] for left in beyond)), most)
    directions = spread @ axes[:, :count].to(spread)
    signs = directions.gather(0, directions.abs().argmax(0, keepdim=True)).sign()
    return Chosen(directions * signs, [*beyond, 0.0][count])


class _Arc(NamedTuple):
    """Paths with their Jacobians and forcing.

    Attributes:
        states: (B, N + 1, D) states.
        jacobians: Jacobians of the steps, (B, N, D, D), float32.
        steps: steps between measurement times.
        driven: part of the states -> field derivatives along the columns of L, (B, n, ., R), float32.
    """

    states: Tensor
    jacobians: Tensor
    steps: Steps
    driven: Callable[[slice], Tensor]

    def moved(self, begin: int, end: int, moved: Tensor, own: Tensor) -> tuple[Tensor, Tensor]:
        """Return S and P' at the state with index `end`, from those at index `begin`."""
        if begin == end:
            return moved, own
        span = Steps(self.steps.lengths[:, begin:end], torch.tensor([end - begin]))
        jacobians = self.jacobians[:, begin:end]
        after = sensitivities(jacobians, self.driven(slice(begin, end + 1)), span, moved)[:, 0]
        carried = transitions(jacobians)[:, -1].to(own)
        return after, carried @ own @ carried.mT


def _whitened_rows(arc: _Arc, segment: Segment, start_sd: Tensor, columns: int) -> Iterator[Tensor]:
    """Yield P^-1/2 S of all paths, (B, D, R), at some times; squared columns are NEES contributions.

    It is 0 after the last measurement of a path, where the filter ends.
    """
    batch, samples = segment.times.shape
    apart = max(1, (samples - 1) // SAMPLES)
    weighed = {*range(apart, samples, apart), samples - 1}
    seen = ~segment.values.isnan()
    last = (seen.any(-1) * torch.arange(samples)).amax(1)[:, None, None]
    updates = {*seen.any(-1).any(0).nonzero().flatten().tolist()}
    own = torch.diag(start_sd**2).to(arc.states).expand(batch, -1, -1)
    moved, here = arc.jacobians.new_zeros(batch, len(start_sd), columns), 0
    for k in sorted(weighed | updates):
        there = int(arc.steps.ends[k])
        moved, own = arc.moved(here, there, moved, own)
        if k in weighed:
            yield _whitened(moved.to(own), own).to(moved) * (k <= last)
        if k in updates:
            sensor = partial(segment.instrument.measurement, t=segment.times[:, k])
            rows = pointwise_jacobian(sensor, arc.states[:, there])
            rows = rows.masked_fill(~seen[:, k].unsqueeze(-1), 0.0)
            moved, own = _updated(moved, own, rows, segment.instrument.deviations)
        here = there


def _whitened(moved: Tensor, own: Tensor) -> Tensor:
    """Return P^-1/2 S, with P = P' + S S^T, from S (..., D, R) and P' (..., D, D)."""
    total = own + moved @ moved.mT
    unit = total.diagonal(dim1=-2, dim2=-1).rsqrt().unsqueeze(-1)
    root = torch.linalg.cholesky(unit * total * unit.mT + LEAST * torch.eye(own.shape[-1]).to(own))
    return torch.linalg.solve_triangular(root, unit * moved, upper=False)


def _updated(moved: Tensor, own: Tensor, rows: Tensor, deviations: Tensor) -> tuple[Tensor, Tensor]:
    """Return S and P' after an update by measurements with Jacobian H, (B, M, D); zero rows are ignored."""
    noise, s = torch.diag(deviations**2).to(own), moved.to(own)
    seen = rows @ (own + s @ s.mT)
    gain = torch.linalg.solve(seen @ rows.mT + noise, seen).mT
    left = torch.eye(own.shape[-1]).to(own) - gain @ rows
    return (left @ s).to(moved), left @ own @ left.mT + gain @ noise @ gain.mT
