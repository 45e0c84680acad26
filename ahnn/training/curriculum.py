"""Schedule of training objectives over epochs, built from loss options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, cast

from torch import Tensor, nn

from ahnn.arguments import Within, check_arguments, checked
from ahnn.errors import UserError
from ahnn.shooting.robust import RobustName
from ahnn.statistics import Statistics
from ahnn.training.loss import Loss, LossOptions
from ahnn.training.objectives import OBJECTIVES, Derivative, Objective
from ahnn.training.shooting import Shooting
from ahnn.training.weak import Weak

RELATIVE, WEAK = "relative", "weak"
"""Names of the stages in the weak form, on full trajectories of measured states: first relative to the
field, then relative to the noise.
"""
WHOLE = "whole"
"""Name of the stage of shooting over full trajectories."""
STAGE = (
    "intervals >= 3, relative, weak or whole, with a fraction of the epochs and optionally the segments "
    "per step"
)


@checked
@dataclass(frozen=True)
class SegmentOptions:
    """Training objective on measurements and its schedule.

    Attributes:
        stages: list of stages: intervals per segment, or `relative`, `weak`, `whole`; the fraction of the
            epochs at which the stage ends; and optionally the segments per step, by default
            `data.batch_size`. Short segments come first: an inaccurate model cannot fit long ones.
        robust: robust loss of residuals: none (squares), huber or student.
        closing: maximum number of final parameter steps on all measurements, before steps in function space.
        balance: 0, since measurements are weighted by standard deviations.

    Raises:
        UserError: the fractions do not increase to 1, or a stage is invalid.
    """

    stages: list[list[int | float | str]]
    robust: RobustName = "none"
    closing: Annotated[int, Within(0, 100)] = 0
    balance: Annotated[float, Within(0, 0)] = 0.0

    def __post_init__(self) -> None:
        """Check that the stages cover the training."""
        if (
            not self.stages
            or not all(map(_is_stage, self.stages))
            or not _covers([s[1] for s in self.stages])
        ):
            message = (
                f"loss.stages: expected {STAGE}; fractions increase to 1, such as [[4, 0.6], [16, 0.8], "
                f"[whole, 1.0, 40]]; received {self.stages}"
            )
            raise UserError(message)


class MeanSquare(nn.Module):
    """Mean square of residuals in standard deviations."""

    def fit(self, statistics: Statistics) -> None:
        """Do nothing: residuals are already normalised."""

    def forward(self, residuals: Tensor) -> Tensor:
        """Return the mean square, a scalar."""
        return residuals.square().mean()


class Phase(NamedTuple):
    """Phase of the training.

    Attributes:
        until: fraction of the epochs at which it ends.
        objective: objective minimised in the phase.
        segments_per_step: number of segments per step; None for the batch size of the data.
        left: minimum number of epochs for later phases.
    """

    until: float
    objective: Objective
    segments_per_step: int | None = None
    left: int = 0


@dataclass(frozen=True, eq=False)
class Curriculum:
    """Sequence of objectives.

    Attributes:
        phases: phases in order; the last ends at 1.
        judge: objective of validations.
        span: number of steps per window that suffices for all phases; None for segments of measurements.
        closing: maximum number of parameter steps on all measurements after the last phase.
    """

    phases: Sequence[Phase]
    judge: Objective
    span: int | None
    closing: int = 0

    def at(self, epoch: int, epochs: int) -> Objective:
        """Return the objective of an epoch, counted from 0."""
        return self._phase(epoch, epochs).objective

    def intervals(self, epoch: int, epochs: int) -> int | None:
        """Return the number of intervals per segment in an epoch; None: full trajectories."""
        return cast(Shooting | Weak, self.at(epoch, epochs)).intervals

    def segments_per_step(self, epoch: int, epochs: int) -> int | None:
        """Return the number of segments per step in an epoch; None for the default of the data."""
        return self._phase(epoch, epochs).segments_per_step

    def _phase(self, epoch: int, epochs: int) -> Phase:
        ends = (min(phase.until * epochs, epochs - phase.left) for phase in self.phases)
        return next((p for p, end in zip(self.phases, ends, strict=True) if epoch < end), self.phases[-1])


def make_curriculum(size: int, window: int, options: dict[str, Any]) -> tuple[nn.Module, Curriculum]:
    """Build the loss for states of D = size components, and the objectives of the training.

    Args:
        size: number D of state components.
        window: number W of recursive predictions.
        options: options of `SegmentOptions` if they contain `stages`, else of `LossOptions`.
    """
    if "stages" in options:
        check_arguments("loss", SegmentOptions, options)
        return MeanSquare(), staged(SegmentOptions(**options))
    check_arguments("loss", LossOptions, options)
    loss = Loss(size, LossOptions(**options))
    return loss, windowed(loss, window)


def windowed(loss: Loss, window: int) -> Curriculum:
    """Build a curriculum of derivative fitting followed by the objective of the loss.

    Unless derivatives are fitted throughout, the objective of the loss has at least one epoch.

    Raises:
        UserError: unknown objective or invalid options.
    """
    fraction, last = loss.options.derivative, named(loss, window)
    if fraction == 0:
        return Curriculum([Phase(1.0, last)], last, window)
    derivative = Derivative(loss, loss.options.order)
    phases = [Phase(1.0, derivative)]
    if fraction < 1:
        phases = [Phase(fraction, derivative, left=1), Phase(1.0, last)]
    return Curriculum(phases, last, max(window, derivative.order))


def named(loss: Loss, window: int) -> Objective:
    """Build the objective named by a loss; raises UserError for an unknown name or option."""
    name, options = loss.options.objective, loss.options.options
    if name not in OBJECTIVES:
        message = (
            f"loss.objective: expected one of {', '.join(OBJECTIVES)}; received {name!r}. Installed "
            f"packages add objectives in the entry-point group {OBJECTIVES.group}"
        )
        raise UserError(message)
    check_arguments("loss.options", OBJECTIVES[name], options, ("loss", "window"))
    return OBJECTIVES[name](loss, window, **options)


def staged(options: SegmentOptions) -> Curriculum:
    """Build a curriculum of shooting over growing segments, validated on full trajectories."""
    stages = cast("list[tuple[int | str, float, int]]", options.stages)
    phases = [Phase(until, objective_of(name, options.robust), *more) for name, until, *more in stages]
    return Curriculum(phases, Shooting(None, options.robust), None, options.closing)


def _is_stage(stage: list[int | float | str]) -> bool:
    """Return whether a value is a stage: intervals or a name, a fraction, and optional segments."""
    if len(stage) not in (2, 3) or isinstance(stage[1], str):
        return False
    if len(stage) == 3 and not (isinstance(stage[2], int) and stage[2] >= 1):
        return False
    return stage[0] in (RELATIVE, WEAK, WHOLE) or (isinstance(stage[0], int) and stage[0] >= 3)


def _covers(ends: list[Any]) -> bool:
    """Return whether fractions increase to 1."""
    return ends == sorted(set(ends)) and ends[0] > 0 and ends[-1] == 1


def objective_of(stage: int | str, robust: RobustName) -> Shooting | Weak:
    """Build the objective of a named stage."""
    if stage in (RELATIVE, WEAK):
        return Weak(robust, stage == RELATIVE)
    return Shooting(None if stage == WHOLE else int(stage), robust)
