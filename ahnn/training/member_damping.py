"""Levenberg-Marquardt steps of all members of an ensemble in one batch, each with its own damping."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.dynamics import Dynamics
from ahnn.dynamics.energy_levels import units_of
from ahnn.dynamics.recorded_flow import is_fixed
from ahnn.training.least_squares import LeastSquaresProblem
from ahnn.training.levenberg_marquardt import ATTEMPTS, LARGEST, SUFFICIENT, LevenbergMarquardt, adapted
from ahnn.training.member_equations import MemberBlock, member_equations, member_residuals
from ahnn.training.normal_equations import Equations
from ahnn.training.objectives import Derivative, Objective, Recursive
from ahnn.types import Window

MOST = 400
"""Number of parameters above which arithmetic outweighs dispatch: members then take steps one by one."""


class StepTaken(NamedTuple):
    """A problem whose step has been taken, for an optimiser that only counts it.

    Attributes:
        mean_square: mean squared residual before the step.
    """

    mean_square: Tensor

    def loss(self, theta: Tensor) -> Tensor:
        """Return the mean squared residual before the step."""
        return self.mean_square

    def equations(self, theta: Tensor, sizes: Sequence[int]) -> Equations:
        """Return equations without a block, which leave the parameters as they are."""
        return Equations(self.mean_square, 1, [])

    def both(self) -> tuple[LeastSquaresProblem, None]:
        """Return this problem, without a held-out one, in the form that an optimiser's closure returns."""
        return self, None


def together_in_steps(objective: Objective, members: Sequence[Dynamics], optimizers: Sequence[Any]) -> bool:
    """Return whether members take second-order steps in one batch: small networks trained on windows."""
    first = [*members[0].parameters()]
    plain = all(isinstance(one, LevenbergMarquardt) and not one.acceleration for one in optimizers)
    small = sum(p.numel() for p in first) <= MOST and units_of(first) is None
    return isinstance(objective, Recursive | Derivative) and plain and small and is_fixed(members[0])


@torch.no_grad()
def member_damped_steps(
    objective: Recursive | Derivative,
    members: Sequence[Dynamics],
    batches: Sequence[Window],
    groups: Sequence[dict[str, Any]],
) -> Tensor:
    """Take a step of each member, and return the mean squared residuals before it, (E,).

    Args:
        objective: training objective.
        members: dynamics, whose parameters are changed.
        batches: windows of each member.
        groups: parameter group of each member's optimiser, with its damping and tolerance.
    """
    parts = [objective.divided(batch) for batch in batches]
    step, check = (joined([part[k] for part in parts]) for k in (0, 1))
    parameters = [list(member.parameters()) for member in members]
    thetas = torch.stack([parameters_to_vector(own) for own in parameters])
    equations = member_equations(objective, members, thetas, step, [p.numel() for p in parameters[0]])
    mean = equations.loss / equations.degrees
    if not equations.blocks:
        return mean

    def losses(moved: Tensor, batch: Window) -> Tensor:
        for theta, own in zip(moved, parameters, strict=True):
            vector_to_parameters(theta, own)
        return member_residuals(objective, members, batch).square().sum(1)

    norms = torch.stack([block.gradient.square().sum(1) for block in equations.blocks]).sum(0).sqrt()
    for group, norm in zip(groups, (2 * norms / equations.degrees).tolist(), strict=True):
        group["gradient_norm"] = norm
    waiting, other = [True] * len(members), losses(thetas, check)
    for _ in range(ATTEMPTS):
        moves, sound = damped_moves(equations.blocks, thetas, [group["damping"] for group in groups])
        moving = sound & torch.tensor(waiting, device=sound.device)
        trial = torch.where(moving.unsqueeze(1), thetas + moves, thetas)
        gains = (equations.loss - losses(trial, step)) / promised(equations.blocks, moves)
        rises = losses(trial, check) / other - 1
        outcomes = zip(gains.tolist(), rises.tolist(), sound.tolist(), strict=True)
        for k, outcome in enumerate(outcomes):
            if waiting[k] and decided(groups[k], *outcome):
                thetas[k], waiting[k] = trial[k], False
        if not any(waiting):
            break
    for theta, own in zip(thetas, parameters, strict=True):
        vector_to_parameters(theta.clone(), own)  # memory of its own, for checkpoints
    return mean


def decided(group: dict[str, Any], gain: float, rise: float, solved: bool) -> bool:
    """Return whether a member takes its step, and adapt its damping.

    Args:
        group: parameter group with damping and tolerance.
        gain: ratio of actual to predicted decrease.
        rise: relative change of the loss on held-out windows.
        solved: whether the equations were positive definite.
    """
    if not solved:
        group["damping"] = min(group["damping"] * 10, LARGEST)
        return False
    rise = rise if gain > SUFFICIENT else 0.0
    accepted = gain > SUFFICIENT and rise <= group["tolerance"]
    group["damping"] = adapted(group["damping"], gain, rise, accepted)
    return accepted


def damped_moves(
    blocks: Sequence[MemberBlock], thetas: Tensor, damping: Sequence[float]
) -> tuple[Tensor, Tensor]:
    """Return the solutions s of (J^T J + damping D) s = -J^T r, (E, P), and whether they exist, (E,).

    D is the diagonal of J^T J plus a thousandth of its mean, as in `normal_equations.metric`.
    """
    moves, by = torch.zeros_like(thetas), thetas.new_tensor(damping).unsqueeze(1)
    sound = torch.ones(len(thetas), dtype=torch.bool, device=thetas.device)
    for block in blocks:
        diagonal = block.matrix.diagonal(dim1=-2, dim2=-1)
        damped = block.matrix + torch.diag_embed(by * (diagonal + 1e-3 * diagonal.mean(1, keepdim=True)))
        factor, info = torch.linalg.cholesky_ex(damped)
        sound &= info == 0
        moves[:, block.columns] = -torch.cholesky_solve(block.gradient.unsqueeze(-1), factor).squeeze(-1)
    return moves.where(sound.unsqueeze(1), 0.0), sound


def promised(blocks: Sequence[MemberBlock], moves: Tensor) -> Tensor:
    """Return r^T r - |r + J s|^2 of the steps s, (E,), by the linear models of the residuals."""
    decrease = moves.new_zeros(len(moves))
    for block in blocks:
        own = moves[:, block.columns]
        bent = (block.matrix @ own.unsqueeze(-1)).squeeze(-1)
        decrease = decrease - (own * (2 * block.gradient + bent)).sum(1)
    return decrease


def joined(windows: Sequence[Window]) -> Window:
    """Concatenate the windows of all members."""
    first = windows[0]
    dt = torch.cat([torch.as_tensor(w.dt) for w in windows]) if isinstance(first.dt, Tensor) else first.dt
    start, increments = (torch.cat([getattr(w, name) for w in windows]) for name in ("start", "increments"))
    return Window(start, increments, dt)
