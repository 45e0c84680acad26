"""Levenberg-Marquardt on mini-batches: second-order steps for networks of a few thousand parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import torch
from torch import Tensor, nn
from torch.nn.utils import parameters_to_vector, vector_to_parameters
from torch.optim import Optimizer

from ahnn.arguments import Positive, checked
from ahnn.dynamics.energy_levels import units_of
from ahnn.errors import UserError
from ahnn.training.acceleration import Bends, accelerated
from ahnn.training.least_squares import LeastSquaresProblem
from ahnn.training.normal_equations import Block, damped_step, gradient_norm, promised_decrease
from ahnn.training.objectives import Objective
from ahnn.training.steppers import SecondOrder

SMALLEST, LARGEST = 1e-14, 1e6
"""Range of the damping."""
SUFFICIENT = 1e-3
"""Minimum ratio of actual to predicted decrease for an accepted step."""
ATTEMPTS = 6
"""Number of dampings tried on one batch before the next one is drawn."""


@checked
class LevenbergMarquardt(Optimizer):
    """Damped Gauss-Newton steps (Marquardt 1963; gain ratio of Nielsen 1999) on random batches.

    The damping is relative to the diagonal of J^T J plus a thousandth of its mean: pure Marquardt damping
    lets saturated units, whose diagonal vanishes, take huge steps. A step must lower the loss of its batch
    and must not raise the loss of held-out windows by more than `tolerance`: a step that overfits its batch
    would ruin the network.

    On the CPU, products, residuals and Jacobians of a step run in parts on all cores available to the process
    (`ahnn.cores`), in addition to the threads of single operations.

    Args:
        params: parameters of the module whose residuals are minimised.
        damping: initial damping, adapted in later steps.
        tolerance: accepted relative increase of the loss on held-out windows.
        acceleration: whether to apply geodesic acceleration, available for measurements.
    """

    stepper = SecondOrder()

    def __init__(
        self,
        params: Iterable[nn.Parameter],
        damping: Positive = 1e-2,
        tolerance: Positive = 0.3,
        acceleration: bool = False,
    ) -> None:
        super().__init__(params, {"damping": damping, "tolerance": tolerance})
        self.acceleration = acceleration

    def check(self, objectives: Iterable[Objective]) -> None:
        """Raise UserError for acceleration without effect: no objective provides second derivatives."""
        if self.acceleration and not any(getattr(objective, "bends", False) for objective in objectives):
            message = (
                "optimizer.acceleration: expected a loss on measurements (loss.stages), whose residuals "
                "have known curvature; received windows of states. Use optimizer=levenberg_marquardt"
            )
            raise UserError(message)

    @torch.no_grad()
    def step(self, closure: Callable[[], tuple[LeastSquaresProblem, LeastSquaresProblem | None]]) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Take one step and return the mean squared residual before it.

        Args:
            closure: returns the problem of the step and the held-out problem, if any.
        """
        with torch.enable_grad():
            problem, held_back = closure()
        group = self.param_groups[0]
        theta = parameters_to_vector(group["params"]).detach()
        loss, degrees, blocks = problem.equations(theta, [p.numel() for p in group["params"]])
        if not blocks:  # no residual of this batch depends on the parameters
            return loss / degrees
        if (units := units_of(group["params"])) is not None:
            blocks = [block._replace(units=units[block.columns]) for block in blocks]
        group["gradient_norm"] = 2 * gradient_norm(blocks) / degrees  # mean square
        other: Tensor | None = None  # held-out loss, computed on demand
        for _ in range(ATTEMPTS):
            straight = damped_step(blocks, group["damping"], theta)
            if straight is None:
                group["damping"] = min(group["damping"] * 10, LARGEST)
                continue
            move = self._followed(problem, theta, blocks, straight)
            if move is None:
                group["damping"] = min(group["damping"] * 3, LARGEST)
                continue
            decrease = loss - problem.loss(theta + move)
            gain, rise = float(decrease / promised_decrease(blocks, straight)), 0.0
            if gain > SUFFICIENT and held_back is not None:
                other = held_back.loss(theta) if other is None else other
                rise = float(held_back.loss(theta + move) / other) - 1
            accepted = gain > SUFFICIENT and rise <= group["tolerance"]
            group["damping"] = adapted(group["damping"], gain, rise, accepted)
            if accepted:
                vector_to_parameters(theta + move, group["params"])
                break
        return loss / degrees

    def _followed(
        self, problem: LeastSquaresProblem, theta: Tensor, blocks: Sequence[Block], straight: Tensor
    ) -> Tensor | None:
        """Return the step, accelerated if requested and possible; None if it is too long."""
        if not (self.acceleration and isinstance(problem, Bends)):
            return straight
        return accelerated(problem, theta, blocks, straight, self.param_groups[0]["damping"])


def adapted(damping: float, gain: float, rise: float, accepted: bool) -> float:
    """Return the damping after a step.

    Args:
        damping: damping of the last step, relative to the diagonal of J^T J.
        gain: ratio of actual to predicted decrease.
        rise: relative change of the loss on held-out windows.
        accepted: whether the step was taken.
    """
    if not accepted:
        factor = 4.0
    else:
        factor = 1 / 3 if gain > 0.75 else 1.0 if gain > 0.25 else 3.0
        factor *= 2.0 if rise > 0 else 1.0
    return min(max(damping * factor, SMALLEST), LARGEST)
