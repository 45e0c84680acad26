"""The error that matters, watched during training: rollouts of validation trajectories."""

from __future__ import annotations

import math
import time
from typing import Annotated, Any, cast

from lightning import Callback, LightningModule, Trainer

from ahnn.arguments import Count, Within, checked
from ahnn.data.datamodule import WindowDataModule
from ahnn.metrics import errors, rmse_pooled, typical_error
from ahnn.rollouts import clock_of, rollout
from ahnn.statistics import Statistics, sampling_interval

LOST = 100.0
"""A position error this many times the size of the system is as bad as any."""


TRIED = 20
"""Steps that are timed to say how long a rollout takes."""


@checked
class ValidationRollout(Callback):
    """Logs `val/rollout`, the typical position error of whole validation rollouts, in the system's unit.

    It is what a user of the model sees, and may choose the best checkpoint: a one-step loss that falls does
    not always mean a rollout that improves. It is `typical_error`, not an RMSE: the rollouts of a model that
    is still poor all end a system's size away from the truth, and an RMSE would choose weights by chance.

    Measurements have no true start to roll out from: a training on them logs nothing, and chooses its weights
    by `val/loss`.

    Args:
        count: trajectories to roll out; 0 rolls out none and logs nothing.
        every: epochs between two rollouts.
    """

    def __init__(self, count: Annotated[int, Within(0)], every: Count) -> None:
        self.count, self.every = count, every
        self.latest = math.inf
        self._measured: float | None = None

    def seconds(self, epoch: int, trainer: Trainer, module: LightningModule, data: WindowDataModule) -> float:
        """Return about how long this takes after an epoch: a few steps of the rollouts, measured."""
        if (
            self.count == 0
            or data.stages is not None
            or ((epoch + 1) % self.every and epoch + 1 != trainer.max_epochs)
        ):
            return 0.0
        if self._measured is None:
            flow, whole = _flow(module), data.trajectories("val").part(slice(self.count))
            dt, start = Statistics.of(whole).dt, whole.states[:, 0]
            clock = whole.clock(clock_of(flow))
            rollout(flow, start, dt, 2, clock=clock)  # the first of all may compile its library
            begin = time.perf_counter()
            rollout(flow, start, dt, TRIED + 1, clock=clock)
            self._measured = (time.perf_counter() - begin) / TRIED * whole.states.shape[1]
        return self._measured

    @property
    def monitored(self) -> tuple[str, ...]:
        """Names of what is logged."""
        return ("val/rollout",) if self.count else ()

    def state_dict(self) -> dict[str, float]:
        """Return the latest value, which epochs without a rollout repeat."""
        return {"latest": self.latest}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take the latest value from a checkpoint."""
        self.latest = state_dict["latest"]

    def on_validation_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Log the value of this epoch, or the latest one; the last epoch always has its own."""
        data = cast(Any, trainer).datamodule
        if self.count == 0 or data.stages is not None:
            return
        epoch = trainer.current_epoch + 1
        if trainer.sanity_checking or epoch % self.every == 0 or epoch == trainer.max_epochs:
            self.latest = self._error(trainer, pl_module)
        pl_module.log("val/rollout", self.latest, logger=False, sync_dist=True)

    def _error(self, trainer: Trainer, pl_module: LightningModule) -> float:
        """Return the typical error of rollouts from the true start of a few validation trajectories."""
        data: WindowDataModule = trainer.datamodule  # pyright: ignore[reportAttributeAccessIssue]
        dof = data.source.space.dof
        whole = data.trajectories("val").part(slice(self.count))
        flow, dt = _flow(pl_module), sampling_interval(whole)
        clock = whole.clock(clock_of(flow))
        prediction = rollout(flow, whole.states[:, 0], dt, whole.states.shape[1], clock=clock)
        position = errors(prediction, whole.states)[:, 1:, :dof]
        size = float(rmse_pooled(whole.states[..., :dof]))
        return float(typical_error(position, ceiling=LOST * size))


def _flow(module: LightningModule) -> Any:
    """Return the flow on the CPU, which takes many small steps of a few trajectories sooner than a GPU."""
    return cast(Any, module).flow().cpu()
