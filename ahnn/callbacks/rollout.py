"""The error that matters, watched during training: rollouts of validation trajectories."""

from __future__ import annotations

from lightning import Callback, LightningModule, Trainer

from ahnn.data import WindowDataModule
from ahnn.errors import UserError
from ahnn.evaluation.rollout import rollout
from ahnn.metrics import errors, rmse_norm
from ahnn.models import AbstractDynamics


class ValidationRollout(Callback):
    """Logs `val/rollout_position`, the rms vector norm of whole validation rollouts, in the system's unit.

    Args:
        count: trajectories to roll out.
        times: how often over the training.
    """

    def __init__(self, count: int, times: int) -> None:
        if count < 1 or times < 1:
            received = f"count={count}, times={times}"
            message = f"callbacks.rollout: expected count >= 1 and times >= 1; received {received}"
            raise UserError(message)
        self.count, self.times = count, times

    def on_validation_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Roll out from the true start of a few validation trajectories."""
        epochs = trainer.max_epochs or 1
        due = (trainer.current_epoch + 1) % max(1, epochs // self.times) == 0
        if trainer.sanity_checking or not trainer.is_global_zero or not due:
            return
        data: WindowDataModule = trainer.datamodule  # pyright: ignore[reportAttributeAccessIssue]
        assert isinstance(pl_module, AbstractDynamics)
        truth = data.trajectories("val").states[: self.count]
        flow = pl_module.flow()
        prediction = rollout(flow, truth[:, 0].to(pl_module.device), data.system.dt, truth.shape[1]).cpu()
        position = errors(prediction, truth)[..., : data.system.dof]
        for logger in trainer.loggers:
            logger.log_metrics({"val/rollout_position": float(rmse_norm(position))}, trainer.global_step)
