"""The error that matters, watched during training: rollouts of validation trajectories."""

from __future__ import annotations

from lightning import Callback, LightningModule, Trainer

from ahnn.data import WindowDataModule
from ahnn.errors import UserError
from ahnn.evaluation.rollout import rollout
from ahnn.metrics import errors, rmse_pooled, typical_error
from ahnn.models import AbstractDynamics

LOST = 100.0
"""A position error this many times the size of the system is as bad as any."""


class ValidationRollout(Callback):
    """Logs `val/rollout`, the typical position error of whole validation rollouts, in the system's unit.

    It is what a user of the model sees, and may choose the best checkpoint: a one-step loss that falls does
    not always mean a rollout that improves. It is `typical_error`, not an RMSE: the rollouts of a model that
    is still poor all end a system's size away from the truth, and an RMSE would choose weights by chance.

    Args:
        count: trajectories to roll out.
        every: epochs between two rollouts.
    """

    def __init__(self, count: int, every: int) -> None:
        if count < 1 or every < 1:
            received = f"count={count}, every={every}"
            message = f"callbacks.rollout: expected count >= 1 and every >= 1; received {received}"
            raise UserError(message)
        self.count, self.every = count, every

    def on_validation_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Roll out from the true start of a few validation trajectories."""
        if trainer.sanity_checking or (trainer.current_epoch + 1) % self.every:
            return
        data: WindowDataModule = trainer.datamodule  # pyright: ignore[reportAttributeAccessIssue]
        assert isinstance(pl_module, AbstractDynamics)
        truth = data.trajectories("val").states[: self.count]
        flow = pl_module.flow()
        prediction = rollout(flow, truth[:, 0].to(pl_module.device), data.system.dt, truth.shape[1]).cpu()
        position = errors(prediction, truth)[:, 1:, : data.system.dof]
        size = float(rmse_pooled(truth[..., : data.system.dof]))
        typical = typical_error(position, ceiling=LOST * size)
        pl_module.log("val/rollout", float(typical), logger=False, sync_dist=True)
