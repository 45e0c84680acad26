"""Levenberg-Marquardt on mini-batches: second-order steps for networks of a few thousand parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import torch
from torch import Tensor, nn
from torch.nn.utils import parameters_to_vector, vector_to_parameters
from torch.optim import Optimizer

from ahnn.errors import UserError
from ahnn.optim.least_squares import LeastSquares

SMALLEST, LARGEST = 1e-14, 1e6
ATTEMPTS = 8


class LevenbergMarquardt(Optimizer):
    """Damped Gauss-Newton steps (Marquardt 1963; gain ratio of Nielsen 1999) on random batches.

    The damping is relative to the diagonal of J^T J plus a thousandth of its mean: pure Marquardt damping
    lets saturated units, whose diagonal vanishes, take huge steps. A step must lower the loss of its batch
    and must not raise the loss of windows held back from it by more than `tolerance`: a step that overfits
    its batch would throw the network away.

    Args:
        params: the parameters of the module whose residuals are minimised.
        damping: of the first step; it adapts from there.
        tolerance: admitted relative rise of the loss on the windows held back.
    """

    def __init__(self, params: Iterable[nn.Parameter], damping: float = 1e-2, tolerance: float = 0.3) -> None:
        if not (damping > 0 and tolerance > 0):
            message = (
                "optimizer levenberg_marquardt: expected damping > 0 and tolerance > 0; "
                f"received damping={damping}, tolerance={tolerance}"
            )
            raise UserError(message)
        super().__init__(params, {"damping": damping, "tolerance": tolerance})

    @torch.no_grad()
    def step(self, closure: Callable[[], tuple[LeastSquares, LeastSquares]]) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Take one step and return the mean squared residual before it.

        Args:
            closure: returns the problem to step on and the one held back.
        """
        with torch.enable_grad():
            problem, held_back = closure()
        group = self.param_groups[0]
        theta = parameters_to_vector(group["params"]).detach()
        residuals, jacobian = problem.residuals(theta), problem.jacobian(theta).detach()
        normal, gradient = jacobian.T @ jacobian, jacobian.T @ residuals
        loss, other = residuals @ residuals, held_back.residuals(theta).square().sum()
        for _ in range(ATTEMPTS):
            move = damped_step(normal, gradient, group["damping"])
            if move is None:
                group["damping"] = min(group["damping"] * 10, LARGEST)
                continue
            promised = -(2 * gradient @ move + move @ (normal @ move))
            gain = float((loss - problem.residuals(theta + move).square().sum()) / promised)
            held = held_back.residuals(theta + move).square().sum() <= (1 + group["tolerance"]) * other
            group["damping"] = adapted(group["damping"], gain, bool(held))
            if gain > 1e-3 and held:
                vector_to_parameters(theta + move, group["params"])
                break
        return loss / residuals.numel()


def damped_step(normal: Tensor, gradient: Tensor, damping: float) -> Tensor | None:
    """Return the solution of (J^T J + damping D) step = -J^T r, or None if the matrix is not definite."""
    diagonal = normal.diagonal()
    matrix = normal + torch.diag(damping * (diagonal + 1e-3 * diagonal.mean()))
    factor, info = torch.linalg.cholesky_ex(matrix)
    if int(info) != 0:
        return None
    return -torch.cholesky_solve(gradient.unsqueeze(-1), factor).squeeze(-1)


def adapted(damping: float, gain: float, held: bool) -> float:
    """Return the damping after a step with this ratio of actual to promised decrease."""
    if not (gain > 1e-3 and held):
        factor = 6.0
    elif gain > 0.75:
        factor = 1 / 3
    else:
        factor = 1.0 if gain > 0.25 else 3.0
    return min(max(damping * factor, SMALLEST), LARGEST)
