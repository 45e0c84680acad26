"""Normal equations of all members of an ensemble in one batch, by `torch.func.vmap` over their parameters.

In a step of a small network, dispatching operations costs more than their arithmetic. Here Jacobians,
products and factorisations of all members are single operations with a leading member axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, cast

import torch
from torch import Tensor
from torch.func import vmap

from ahnn.clock import on_clock
from ahnn.dynamics import Dynamics, HasField, StackedDynamics
from ahnn.dynamics.derivatives import increment_jacobian, mapped_jacobian
from ahnn.training.normal_equations import independent, used_rows
from ahnn.training.objectives import Derivative, Recursive, derivative_samples
from ahnn.types import Window


class MemberBlock(NamedTuple):
    """Normal equations of a block of K parameters of E members.

    Attributes:
        columns: indices of the parameters, (K,).
        matrix: J^T J, (E, K, K).
        gradient: J^T r, (E, K).
    """

    columns: Tensor
    matrix: Tensor
    gradient: Tensor


class MemberEquations(NamedTuple):
    """Quadratic models of E least-squares problems.

    Attributes:
        loss: sums of squared residuals, (E,).
        degrees: number of residuals of each.
        blocks: blocks of the normal equations.
    """

    loss: Tensor
    degrees: int
    blocks: list[MemberBlock]


def member_residuals(objective: Recursive | Derivative, members: Sequence[Dynamics], batch: Window) -> Tensor:
    """Return the residuals of members at their current parameters, (E, N); `batch` has E B rows."""
    stacked = cast(Dynamics, StackedDynamics(members))
    return objective.residuals(stacked, batch).unflatten(0, (len(members), -1)).flatten(1)


def member_equations(
    objective: Recursive | Derivative,
    members: Sequence[Dynamics],
    thetas: Tensor,
    batch: Window,
    sizes: Sequence[int],
) -> MemberEquations:
    """Return the equations of all members.

    Args:
        objective: training objective.
        members: the dynamics, with the parameters `thetas`.
        thetas: (E, P), in float64.
        batch: concatenated windows of all members.
        sizes: sizes of the tensors that form the P parameters.
    """
    residuals = member_residuals(objective, members, batch)
    if isinstance(objective, Recursive):
        jacobian = _of_steps(objective, members, thetas, batch)
    else:
        jacobian = _of_field(objective, members, thetas, batch)
    columns = torch.arange(jacobian.shape[-1], device=jacobian.device).split(list(sizes))
    nonzero = (jacobian != 0).any(0)
    used = torch.stack([used_rows(part) for part in nonzero.split(list(sizes), dim=-1)], dim=-1)
    blocks = []
    for chosen in independent(used):
        block = torch.cat([part for part, taken in zip(columns, chosen.tolist(), strict=True) if taken])
        own = jacobian[..., block]
        gradient = (own.mT @ residuals.to(own).unsqueeze(-1)).squeeze(-1)
        blocks.append(MemberBlock(block, (own.mT @ own).to(thetas), gradient.to(thetas)))
    return MemberEquations(residuals.square().sum(1), residuals.shape[1], blocks)


def _of_field(objective: Derivative, members: Sequence[Dynamics], thetas: Tensor, batch: Window) -> Tensor:
    """Return the Jacobians of weighted derivatives, (E, B D, P), float32."""
    count, first = len(members), members[0]
    middle, target = derivative_samples(batch.first(objective.order))
    factors = batch.dt * objective.loss.weights(target)
    rows = mapped_jacobian(first, lambda x: cast(HasField, first).field(x))
    return vmap(rows)(thetas, middle.unflatten(0, (count, -1)), factors.unflatten(0, (count, -1))).flatten(
        1, 2
    )


def _of_steps(objective: Recursive, members: Sequence[Dynamics], thetas: Tensor, batch: Window) -> Tensor:
    """Return the Jacobians of weighted recursive predictions, (E, B W D, P), float32."""
    count, first = len(members), members[0]
    batch = batch.first(objective.window)
    weights = objective.loss.weights(batch.increments).float().unflatten(0, (count, -1))
    derivatives, stacked = increment_jacobian(first, first.increment), StackedDynamics(members)
    state = batch.start.unflatten(0, (count, -1))
    one = torch.eye(state.shape[-1], device=state.device)
    moved = torch.zeros(*state.shape, thetas.shape[1], device=state.device)
    rows = torch.empty(*weights.shape, thetas.shape[1], device=state.device)
    for k in range(weights.shape[2]):
        step = batch.step(k)
        grouped = step.unflatten(0, (count, -1)) if isinstance(step, Tensor) else step
        axes = (0, 0, 0 if isinstance(step, Tensor) else None)
        of_theta, of_state = vmap(derivatives, axes)(thetas, state, grouped)
        moved = of_theta + (of_state + one) @ moved
        rows[:, :, k] = moved * weights[:, :, k].unsqueeze(-1)
        target = batch.increments[:, k]
        increment = on_clock(stacked.increment(state.flatten(0, 1), step), target, first.clock)
        state = state + increment.unflatten(0, (count, -1))
    return rows.flatten(1, 3)
