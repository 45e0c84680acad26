"""Paths from random starts and parameters, for errors that are too large to propagate to first order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor
from torch.func import vjp, vmap
from torch.nn.utils import parameters_to_vector

from ahnn.clock import Clock
from ahnn.dynamics import Dynamics
from ahnn.dynamics.derivatives import parametrised
from ahnn.rollouts import stepped
from ahnn.uncertainty.domain import Domain, growth

Step = Callable[[Tensor, Tensor, Clock | None], Tensor]
"""(states (S, B, D), lengths (B,), clock) -> states after the step."""


ENOUGH = 8
"""Minimum number of draws, half of them independent, for each cause whose sample covariance is matched."""


class Draws(NamedTuple):
    """Random starts, and random displacements of the parameters.

    Attributes:
        starts: (S, B, D).
        moves: (S, P), common to all paths of a draw; None for exact parameters.
    """

    starts: Tensor
    moves: Tensor | None


def drawn(
    start: Tensor,
    count: int,
    seed: int,
    *,
    own: Tensor | None,
    common: Tensor | None,
    spread: Tensor | None,
    matched: bool = False,
) -> Draws:
    """Draw starts and parameters in pairs of opposite sign, so that linear effects cancel in the mean.

    Args:
        start: (B, D) means of the starts.
        count: number S of draws.
        seed: random seed.
        own: columns (B, D, R) or (D, R) of independent causes for each start, of unit variance; None without.
        common: columns (B, D, Q) of the causes of the parameters, if the starts depend on these, too.
        spread: factor (P, Q) of the covariance of the parameters; None for exact parameters.
        matched: whether the own causes of each start have exactly unit sample covariance, if there are enough
            draws: second-order exact sampling (Pham 2001, Mon. Weather Rev. 129, 1194). The linear part of a
            covariance then has no sampling error, which for few starts would not average out.
    """
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        half = torch.randn(-(-count // 2), *shape, generator=generator, dtype=torch.float64)
        return torch.cat((half, -half))[:count].to(start.device)

    starts, moves = start.double().expand(count, *start.shape), None
    if spread is not None:
        causes = normal(spread.shape[1])
        moves = causes @ spread.double().mT
        if common is not None:
            starts = starts + torch.einsum("bdq,sq->sbd", common.double(), causes)
    if own is not None:
        columns = own.double().expand(len(start), *own.shape[-2:])
        causes = normal(len(start), columns.shape[-1])
        if matched and count >= ENOUGH * columns.shape[-1]:
            causes = with_unit_covariance(causes)
        starts = starts + torch.einsum("bdr,sbr->sbd", columns, causes)
    return Draws(starts, moves)


def with_unit_covariance(causes: Tensor) -> Tensor:
    """Return causes (S, B, R) of zero mean, transformed to unit sample covariance for each start."""
    factor = torch.linalg.cholesky(torch.einsum("sbr,sbq->brq", causes, causes) / (len(causes) - 1))
    return torch.linalg.solve_triangular(factor, causes.permute(1, 2, 0), upper=False).permute(2, 0, 1)


@torch.no_grad()
def sampled_paths(
    dynamics: Dynamics,
    draws: Draws,
    lengths: Tensor,
    domain: Domain | None = None,
    clock: Clock | None = None,
) -> Iterator[Tensor]:
    """Yield the states (S, B, D) of all draws at the start and after each step.

    Increments are linearised in the parameters; paths are not. Over the wide range of undetermined parameters
    a network is nonlinear, and direct draws are meaningless (Immer, Korzepa & Bauer 2021, AISTATS).

    Args:
        dynamics: float64 dynamics with parameters theta.
        draws: starts and parameters.
        lengths: step lengths, (B, N) or (N,).
        domain: training domain, beyond which the effect of the parameters is larger (`growth`).
        clock: time and controls at the start of each step, (N, k) or (B, N, k).
    """
    x, step = draws.starts, step_of(dynamics, draws.moves, domain)
    yield x
    each = lengths.expand(x.shape[1], -1).double()
    for k, dt in enumerate(each.unbind(1)):
        x = step(x, dt, None if clock is None else clock.at(k))
        yield x


def step_of(dynamics: Dynamics, moves: Tensor | None, domain: Domain | None) -> Step:
    """Return the step of all draws, with displaced parameters (S, P) if there are any."""
    if moves is None:
        return lambda x, dt, clock: _exact(dynamics, x, dt, clock)
    theta = parameters_to_vector(dynamics.parameters()).detach()

    def changed(move: Tensor, x: Tensor, dt: Tensor, clock: Clock | None) -> tuple[Tensor, Tensor]:
        def after(parameters: Tensor) -> Tensor:
            return stepped(lambda x, dt: x + increment(parameters, x, dt), x, dt, clock)

        # J times the move is the gradient of u -> (u^T J) move: two reverse modes support any operation.
        state, pulled = cast(Any, vjp(after, theta))
        _, change = cast(Any, vjp(lambda u: pulled(u)[0], torch.zeros_like(x)))
        return state, change(move)[0]

    increment = parametrised(dynamics, dynamics.increment, theta.dtype)
    all_draws = vmap(changed, (0, 0, None, None))

    def step(x: Tensor, dt: Tensor, clock: Clock | None) -> Tensor:
        state, change = all_draws(moves, x, dt, clock)
        if domain is not None:
            change = change * growth(domain.novelty(dynamics, x)).unsqueeze(-1)
        return state + change

    return step


def _exact(dynamics: Dynamics, x: Tensor, dt: Tensor, clock: Clock | None) -> Tensor:
    """Return the states (S, B, D) after a step of all draws with the same parameters."""
    own = None
    if clock is not None:
        own = Clock(*(part.expand(*x.shape[:-1], part.shape[-1]).flatten(0, 1) for part in clock))
    lengths = dt.expand(x.shape[:-1]).flatten()
    return stepped(dynamics, x.flatten(0, 1), lengths, own).view_as(x)


def sampled_rollouts(
    dynamics: Dynamics, start: Tensor, lengths: Tensor, factor: Tensor, count: int, seed: int = 0
) -> Tensor:
    """Return rollouts (count, B, N + 1, D) of dynamics whose parameters are drawn from N(theta, L L^T).

    Args:
        dynamics: float64 dynamics with parameters theta.
        start: (B, D) initial states.
        lengths: step lengths, (B, N).
        factor: L, shape (P, R).
        count: number of draws.
        seed: random seed.
    """
    draws = drawn(start, count, seed, own=None, common=None, spread=factor)
    return torch.stack([*sampled_paths(dynamics, draws, lengths)], dim=2)
