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
"""Share of the promised decrease that a step must bring."""
ATTEMPTS = 6
"""Dampings tried on one batch before the next one is drawn."""


@checked
class LevenbergMarquardt(Optimizer):
    """Damped Gauss-Newton steps (Marquardt 1963; gain ratio of Nielsen 1999) on random batches.

    The damping is relative to the diagonal of J^T J plus a thousandth of its mean: pure Marquardt damping
    lets saturated units, whose diagonal vanishes, take huge steps. A step must lower the loss of its batch
    and must not raise the loss of windows held back from it by more than `tolerance`: a step that overfits
    its batch would throw the network away.

    On the CPU the products of a step, its residuals and Jacobians run in parts on all cores that the process
    may use (`ahnn.cores`), beside the threads of single operations.

    Args:
        params: the parameters of the module whose residuals are minimised.
        damping: of the first step; it adapts from there.
        tolerance: admitted relative rise of the loss on the windows held back.
        acceleration: let steps follow the bend of the residuals where it is known, on measurements.
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
        """Raise UserError for acceleration where it would change nothing: no objective knows a bend."""
        if self.acceleration and not any(getattr(objective, "bends", False) for objective in objectives):
            message = (
                "optimizer.acceleration: expected stages of measurements (loss.stages), the bend of whose "
                "residuals is known; received windows of states. Use optimizer=levenberg_marquardt"
            )
            raise UserError(message)

    @torch.no_grad()
    def step(self, closure: Callable[[], tuple[LeastSquaresProblem, LeastSquaresProblem | None]]) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Take one step and return the mean squared residual before it.

        Args:
            closure: returns the problem to step on and the one held back, if any is.
        """
        with torch.enable_grad():
            problem, held_back = closure()
        group = self.param_groups[0]
        theta = parameters_to_vector(group["params"]).detach()
        loss, degrees, blocks = problem.equations(theta, [p.numel() for p in group["params"]])
        if not blocks:  # nothing depends on the parameters: another batch may
            return loss / degrees
        if (units := units_of(group["params"])) is not None:
            blocks = [block._replace(units=units[block.columns]) for block in blocks]
        group["gradient_norm"] = 2 * gradient_norm(blocks) / degrees  # of the mean square
        other: Tensor | None = None  # the loss held back, once it is asked for
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
        """Return the step, accelerated if that is asked for and known; None where it is too long for that."""
        if not (self.acceleration and isinstance(problem, Bends)):
            return straight
        return accelerated(problem, theta, blocks, straight, self.param_groups[0]["damping"])


def adapted(damping: float, gain: float, rise: float, accepted: bool) -> float:
    """Return the damping after a step.

    Args:
        damping: of the step.
        gain: ratio of its actual to its promised decrease.
        rise: relative change of the loss on the windows held back.
        accepted: whether the step was taken.
    """
    if not accepted:
        factor = 4.0
    else:
        factor = 1 / 3 if gain > 0.75 else 1.0 if gain > 0.25 else 3.0
        factor *= 2.0 if rise > 0 else 1.0
    return min(max(damping * factor, SMALLEST), LARGEST)
