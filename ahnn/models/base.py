"""The one abstract LightningModule: training, validation and the flow, around a learned increment."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, Protocol, cast

import torch
from lightning import LightningModule
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from ahnn.arguments import check_arguments
from ahnn.errors import TrainingError
from ahnn.models.losses import Loss, derivative_residuals, recursive_residuals
from ahnn.normalisation import Statistics
from ahnn.optim import LeastSquares, LevenbergMarquardt, least_squares
from ahnn.types import Flow, TimeStep, Window


class Learner(Protocol):
    """The trainable part of a model: a module that can take its constants from statistics."""

    def fit(self, statistics: Statistics) -> None:
        """Set scalings and units from the training split."""
        ...

    def __call__(self, x: Tensor) -> Tensor:
        """Return a field or an increment, shape (..., D), at the states x, shape (..., D)."""
        ...


class Optimisation(NamedTuple):
    """Factories of the optimiser and its scheduler, which belong to a training and not to a model."""

    optimizer: Callable[[Iterable[nn.Parameter]], Optimizer]
    scheduler: Callable[[Optimizer], LRScheduler] | None


class AbstractDynamics(LightningModule, ABC):
    """A model of dynamics: it maps a state and a time step to an increment of the state.

    Final subclasses provide `increment`; nothing else is overridden.

    Args:
        learner: the trainable part.
        dof: degrees of freedom n.
        loss: options of `Loss`.
    """

    loss_scale: Tensor
    dt: Tensor

    def __init__(self, learner: nn.Module, dof: int, loss: dict[str, Any]) -> None:
        super().__init__()
        self.learner = learner
        self.dof = dof
        check_arguments("loss", Loss, loss)
        self.loss = Loss(**loss)
        self.register_buffer("loss_scale", torch.ones(2 * dof))
        self.register_buffer("dt", torch.zeros((), dtype=torch.float64))
        self.optimisation: Optimisation | None = None
        self.provenance: dict[str, Any] = {}

    @abstractmethod
    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return x(t + dt) - x(t), shape (B, D), predicted for the states x, shape (B, D)."""

    def residuals(self, window: Window) -> Tensor:
        """Return the residuals of a batch in units of the loss scale, shape (B, W, D)."""
        if self.loss.kind == "derivative":
            residuals, targets = derivative_residuals(cast(Learner, self.learner), window)
        else:
            residuals, targets = recursive_residuals(self.increment, window), window.increments
        return self.loss.scaled(residuals, targets, self.loss_scale)

    def forward(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (B, D) that the states x, shape (B, D), reach after dt."""
        return x + self.increment(x, dt)

    def flow(self) -> Flow:
        """Return a float64 copy of the model as a flow, for evaluation and filters."""
        return copy.deepcopy(self).double().eval().requires_grad_(False)

    @torch.no_grad()
    def calibrate(self, statistics: Statistics) -> None:
        """Fit scalings, units and the loss scale to the training split."""
        cast(Learner, self.learner).fit(statistics)
        half_range = (statistics.maximum - statistics.minimum) / 2
        self.loss_scale.copy_(statistics.increment if self.loss.scale == "increment" else half_range)
        self.dt.fill_(statistics.dt)

    def configure_optimizers(self) -> Any:
        """Return optimiser and per-epoch scheduler for Lightning."""
        assert self.optimisation is not None, "set `optimisation` before fit"
        optimizer = self.optimisation.optimizer(self.parameters())
        self.automatic_optimization = not isinstance(optimizer, LevenbergMarquardt)
        if self.optimisation.scheduler is None or not self.automatic_optimization:
            return optimizer
        scheduler = self.optimisation.scheduler(optimizer)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": scheduler, "interval": "epoch"}}

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add what the model was trained on, and its latest validation loss, as plain values."""
        loss = self.trainer.callback_metrics.get("val/loss")
        checkpoint["ahnn"] = {**self.provenance, "val_loss": None if loss is None else float(loss)}

    def training_step(self, batch: Window, batch_idx: int) -> Tensor:
        """Return the loss of one batch.

        Raises:
            TrainingError: the loss is not finite.
        """
        if self.automatic_optimization:
            loss = self.loss(self.residuals(batch))
        else:
            loss = cast(Any, self.optimizers()).step(lambda: self.problems(batch))
        if not loss.isfinite():
            message = (
                f"training: the loss became {float(loss.detach())} in epoch {self.current_epoch}, "
                f"batch {batch_idx}; the last good checkpoint is kept. Try a smaller optimizer.lr or window."
            )
            raise TrainingError(message)
        return loss

    def problems(self, batch: Window) -> tuple[LeastSquares, LeastSquares]:
        """Return four fifths of a batch as the problem to step on, and the rest to check the step."""
        split = max(1, batch.start.shape[0] // 5)

        def residuals(start: Tensor, increments: Tensor) -> Tensor:
            return self.residuals(Window(start, increments, batch.dt))

        main, rest = (
            least_squares(self, residuals, (batch.start[part], batch.increments[part]))
            for part in (slice(split, None), slice(None, split))
        )
        return main, rest

    def validation_step(self, batch: Window, batch_idx: int) -> None:
        """Log `val/loss`, and the one-step rms residual `val/one_step` in units of the loss scale."""
        del batch_idx
        size = batch.start.shape[0]
        residual = (self.increment(batch.start, batch.dt) - batch.increments[:, 0]) / self.loss_scale
        one_step = residual.square().mean().sqrt()
        options: dict[str, Any] = {"batch_size": size, "on_epoch": True, "logger": False}
        self.log("val/loss", self.loss(self.residuals(batch)), **options)
        self.log("val/one_step", one_step, **options)
