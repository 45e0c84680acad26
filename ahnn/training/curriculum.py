"""Which objective holds in an epoch, from the options of a loss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, cast

from torch import Tensor, nn

from ahnn.arguments import Within, check_arguments, checked
from ahnn.errors import UserError
from ahnn.shooting.robust import RobustName
from ahnn.statistics import Statistics
from ahnn.training.loss import Loss, LossOptions
from ahnn.training.objectives import Derivative, Objective, Recursive
from ahnn.training.posterior import Posterior
from ahnn.training.shooting import Shooting
from ahnn.training.weak import Weak

WEAK = "weak"
"""Name of the stage in the weak form, on whole trajectories of measured states."""
WHOLE, ALL = "whole", "all"
"""Names of the stages on whole trajectories: some in each step, or all of them."""


@checked
@dataclass(frozen=True)
class SegmentOptions:
    """What training on measurements minimises, and when.

    Attributes:
        stages: intervals of a stretch, `weak`, `whole` or `all`, and the fraction of the epochs up to which
            they hold. Short ones first: over long ones a model that is still wrong never meets them.
        robust: the loss of single residuals: none (squares), huber or student.
        closing: steps on all measurements, at most, that follow the last epoch.
        balance: 0, since standard deviations weigh measurements.

    Raises:
        UserError: fractions that do not increase to 1, or stretches that are none.
    """

    stages: list[list[int | float | str]]
    robust: RobustName = "none"
    closing: Annotated[int, Within(0, 100)] = 2
    balance: Annotated[float, Within(0, 0)] = 0.0

    def __post_init__(self) -> None:
        """Refuse stages that do not cover the training."""
        if (
            not self.stages
            or not all(map(_is_stage, self.stages))
            or not _covers([s[1] for s in self.stages])
        ):
            message = (
                "loss.stages: expected intervals >= 3, weak, whole or all, with fractions of the epochs that "
                f"increase to 1, such as [[4, 0.6], [16, 0.8], [all, 1.0]]; received {self.stages}"
            )
            raise UserError(message)


class MeanSquare(nn.Module):
    """Mean square of residuals in standard deviations."""

    def fit(self, statistics: Statistics) -> None:
        """Nothing to set: measurements bring their unit along."""

    def forward(self, residuals: Tensor) -> Tensor:
        """Return the mean square, a scalar."""
        return residuals.square().mean()


@dataclass(frozen=True, eq=False)
class Curriculum:
    """Objectives one after the other.

    Attributes:
        phases: fraction of the epochs up to which each holds, increasing to 1, and the objective.
        judge: the objective of validations.
        span: steps that a window of any phase must have; None for stretches of measurements.
    """

    phases: Sequence[tuple[float, Objective]]
    judge: Objective
    span: int | None

    def at(self, epoch: int, epochs: int) -> Objective:
        """Return the objective of an epoch, counted from 0."""
        return next((o for until, o in self.phases if epoch < until * epochs), self.phases[-1][1])

    def intervals(self, epoch: int, epochs: int) -> int | None:
        """Return the intervals of a stretch in an epoch; None takes whole trajectories."""
        return cast(Shooting | Weak, self.at(epoch, epochs)).intervals

    def all_at_once(self, epoch: int, epochs: int) -> bool:
        """Return whether each step of an epoch takes all stretches."""
        return cast(Shooting | Weak, self.at(epoch, epochs)).all_at_once


def make_curriculum(size: int, window: int, options: dict[str, Any]) -> tuple[nn.Module, Curriculum]:
    """Return the loss of states of D = size components, and the objectives of a training.

    Args:
        size: D.
        window: W of recursive predictions.
        options: of `SegmentOptions`, where there are `stages`, or else of `LossOptions`.
    """
    if "stages" in options:
        check_arguments("loss", SegmentOptions, options)
        return MeanSquare(), staged(SegmentOptions(**options))
    check_arguments("loss", LossOptions, options)
    loss = Loss(size, LossOptions(**options))
    return loss, windowed(loss, window)


def windowed(loss: Loss, window: int) -> Curriculum:
    """Return derivatives first and recursive predictions after them, as the options of the loss say."""
    fraction, recursive = loss.options.derivative, Recursive(loss, window)
    if fraction == 0:
        return Curriculum([(1.0, recursive)], recursive, window)
    derivative = Derivative(loss, loss.options.order)
    phases = [(1.0, derivative)] if fraction == 1 else [(fraction, derivative), (1.0, recursive)]
    return Curriculum(phases, recursive, max(window, derivative.order))


def staged(options: SegmentOptions) -> Curriculum:
    """Return shooting over stretches that grow; whole trajectories judge."""
    phases = [
        (until, objective_of(name, options.robust))
        for name, until in cast("list[tuple[int | str, float]]", options.stages)
    ]
    return Curriculum(phases, Shooting(None, options.robust), None)


def _is_stage(stage: list[int | float | str]) -> bool:
    """Return whether this is a stage: intervals or a name, and a fraction."""
    if len(stage) != 2 or isinstance(stage[1], str):
        return False
    return stage[0] in (WHOLE, ALL, WEAK) or (isinstance(stage[0], int) and stage[0] >= 3)


def _covers(ends: list[Any]) -> bool:
    """Return whether fractions increase to 1."""
    return ends == sorted(set(ends)) and ends[0] > 0 and ends[-1] == 1


def objective_of(stage: int | str, robust: RobustName) -> Shooting | Weak:
    """Return the objective of a stage of this name."""
    if stage == WEAK:
        return Weak(robust)
    if stage == ALL:
        return Posterior(robust=robust)
    return Shooting(None if stage == WHOLE else int(stage), robust)
