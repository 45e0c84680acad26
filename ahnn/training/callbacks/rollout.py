"""Rollout error on validation trajectories, monitored during training."""

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
"""Upper limit of position errors, as a multiple of the system size."""


TRIED = 20
"""Number of steps timed to estimate the duration of a rollout."""


@checked
class ValidationRollout(Callback):
    """Logs `val/rollout`, the typical position error of full validation rollouts, in the system's unit.

    This is the error relevant to users, and can select the best checkpoint: a decreasing one-step loss does
    not always improve rollouts. It is the `typical_error`, not an RMSE: rollouts of a poor model all end at a
    distance of the system size from the truth, and an RMSE would select weights by chance.

    Measurements have no true initial state for a rollout: training on them logs nothing, and selects weights
    by `val/loss`. The loss of windows of full trajectories already measures full predictions: there, rollouts
    are computed only where a callback monitors them.

    Args:
        count: number of trajectories; 0 logs nothing.
        every: number of epochs between rollouts.
    """

    def __init__(self, count: Annotated[int, Within(0)], every: Count) -> None:
        self.count, self.every = count, every
        self.latest = math.inf
        self._measured: float | None = None

    def seconds(self, epoch: int, trainer: Trainer, module: LightningModule, data: WindowDataModule) -> float:
        """Estimate the duration of the rollouts in an epoch, in seconds, from a few timed steps."""
        if self._silent(trainer, data) or ((epoch + 1) % self.every and epoch + 1 != trainer.max_epochs):
            return 0.0
        if self._measured is None:
            flow, whole = _flow(module), data.trajectories("val").part(slice(self.count))
            dt, start = Statistics.of(whole).dt, whole.states[:, 0]
            clock = whole.clock(clock_of(flow))
            rollout(flow, start, dt, 2, clock=clock)  # the first call may compile a library
            begin = time.perf_counter()
            rollout(flow, start, dt, TRIED + 1, clock=clock)
            self._measured = (time.perf_counter() - begin) / TRIED * whole.states.shape[1]
        return self._measured

    @property
    def monitored(self) -> tuple[str, ...]:
        """Names of the logged metrics."""
        return ("val/rollout",) if self.count else ()

    def state_dict(self) -> dict[str, float]:
        """Return the latest value, which is repeated in epochs without a rollout."""
        return {"latest": self.latest}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the latest value from a checkpoint."""
        self.latest = state_dict["latest"]

    def on_validation_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Log the value of this epoch, or the latest one; the last epoch always computes one."""
        if (value := self.judge(trainer, pl_module)) is not None:
            pl_module.log("val/rollout", value, logger=False, sync_dist=True)

    def judge(self, trainer: Trainer, module: LightningModule) -> float | None:
        """Return the value of a model in this epoch, or the latest one; None where none is computed."""
        if self._silent(trainer, cast(Any, trainer).datamodule):
            return None
        epoch = trainer.current_epoch + 1
        if trainer.sanity_checking or epoch % self.every == 0 or epoch == trainer.max_epochs:
            self.latest = self._error(trainer, module)
        return self.latest

    def _silent(self, trainer: Trainer, data: WindowDataModule) -> bool:
        if self.count == 0 or data.stages is not None:
            return True
        if any(getattr(callback, "monitor", None) == "val/rollout" for callback in trainer.callbacks):  # pyright: ignore[reportAttributeAccessIssue]
            return False
        return data.window + 1 == data.trajectories("val").states.shape[1]

    def _error(self, trainer: Trainer, pl_module: LightningModule) -> float:
        """Return the typical error of rollouts from true initial states of a few validation trajectories."""
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
    """Return the flow on the CPU, which is faster than a GPU for many small steps of few trajectories."""
    return cast(Any, module).flow().cpu()
