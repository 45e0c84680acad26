"""The error that matters, watched during training: rollouts of validation trajectories."""

from __future__ import annotations

import math
from typing import Annotated, Any

from lightning import Callback, LightningModule, Trainer

from ahnn.arguments import Count, Within, checked
from ahnn.data import WindowDataModule
from ahnn.evaluation.rollout import rollout
from ahnn.metrics import errors, rmse_pooled, typical_error
from ahnn.models import AbstractDynamics

LOST = 100.0
"""A position error this many times the size of the system is as bad as any."""


@checked
class ValidationRollout(Callback):
    """Logs `val/rollout`, the typical position error of whole validation rollouts, in the system's unit.

    It is what a user of the model sees, and may choose the best checkpoint: a one-step loss that falls does
    not always mean a rollout that improves. It is `typical_error`, not an RMSE: the rollouts of a model that
    is still poor all end a system's size away from the truth, and an RMSE would choose weights by chance.

    Args:
        count: trajectories to roll out; 0 rolls out none and logs nothing.
        every: epochs between two rollouts.
    """

    def __init__(self, count: Annotated[int, Within(0)], every: Count) -> None:
        self.count, self.every = count, every
        self.latest = math.inf

    def state_dict(self) -> dict[str, float]:
        """Return the latest value, which epochs without a rollout repeat."""
        return {"latest": self.latest}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take the latest value from a checkpoint."""
        self.latest = state_dict["latest"]

    def on_validation_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Log the value of this epoch, or the latest one; the last epoch always has its own."""
        if trainer.sanity_checking or self.count == 0:
            return
        epoch = trainer.current_epoch + 1
        if epoch % self.every == 0 or epoch == trainer.max_epochs:
            self.latest = self._error(trainer, pl_module)
        pl_module.log("val/rollout", self.latest, logger=False, sync_dist=True)

    def _error(self, trainer: Trainer, pl_module: LightningModule) -> float:
        """Return the typical error of rollouts from the true start of a few validation trajectories."""
        data: WindowDataModule = trainer.datamodule  # pyright: ignore[reportAttributeAccessIssue]
        assert isinstance(pl_module, AbstractDynamics)
        truth = data.trajectories("val").states[: self.count]
        flow = pl_module.flow()
        prediction = rollout(flow, truth[:, 0].to(pl_module.device), data.system.dt, truth.shape[1]).cpu()
        position = errors(prediction, truth)[:, 1:, : data.system.dof]
        size = float(rmse_pooled(truth[..., : data.system.dof]))
        return float(typical_error(position, ceiling=LOST * size))
