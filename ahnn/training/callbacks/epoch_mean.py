"""Averages of the weights over an epoch: after single batches they scatter about the optimum of all."""

from __future__ import annotations

from typing import Annotated, Any

import torch
from lightning import Callback, LightningModule, Trainer
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from ahnn.arguments import Within, checked


@checked
class EpochMean(Callback):
    """Sets the weights at the end of each of the last epochs to their mean over its steps.

    The mean of many steps about an optimum is closer to it than each of the steps (Polyak & Juditsky 1992,
    SIAM J. Control Optim. 30, 838-855). Validation, checkpoints and the next epoch use this mean.

    Args:
        fraction: fraction of the epochs, at the end of the training; 0: no averages.
    """

    def __init__(self, fraction: Annotated[float, Within(0, 1)]) -> None:
        self.fraction = fraction
        self.steps, self.total = 0, torch.zeros(())

    @torch.no_grad()
    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Add the weights of this step, and set the mean after the last step."""
        epochs = trainer.max_epochs or 1
        if trainer.current_epoch < (1 - self.fraction) * epochs:
            return
        parameters = list(pl_module.parameters())
        self.total = self.total.to(parameters[0].device) + parameters_to_vector(parameters).detach().double()
        self.steps += 1
        if trainer.is_last_batch:
            parts = (self.total / self.steps).split([p.numel() for p in parameters])
            for parameter, part in zip(parameters, parts, strict=True):
                parameter.copy_(part.view_as(parameter))  # in place: recorded steps use fixed addresses
            self.steps, self.total = 0, torch.zeros(())

    def state_dict(self) -> dict[str, Any]:
        """Return the sum of the weights and the number of steps in this epoch."""
        return {"steps": self.steps, "total": self.total}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continue within an epoch."""
        total: Tensor = state_dict["total"]
        self.steps, self.total = state_dict["steps"], total.clone()
