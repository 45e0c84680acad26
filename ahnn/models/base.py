"""The one abstract LightningModule: training, validation and the flow, around a learned increment."""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple, Protocol, cast

import torch
from lightning import LightningModule
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from ahnn.arguments import check_arguments
from ahnn.dynamics.scaling import Statistics
from ahnn.errors import TrainingError
from ahnn.training import LeastSquares, LevenbergMarquardt, pointwise_problem, recursive_problem
from ahnn.training.objectives import Loss, derivative_samples, recursive_residuals
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
        window: W, steps of the recursive predictions in the loss.
        loss: options of `Loss`.
    """

    loss_scale: Tensor
    dt: Tensor

    def __init__(self, learner: nn.Module, dof: int, window: int, loss: dict[str, Any]) -> None:
        super().__init__()
        self.learner = learner
        self.dof, self.window = dof, window
        check_arguments("loss", Loss, loss)
        self.loss = Loss(**loss)
        self.register_buffer("loss_scale", torch.ones(2 * dof))
        self.register_buffer("dt", torch.zeros((), dtype=torch.float64))
        self.optimisation: Optimisation | None = None
        self.provenance: dict[str, Any] = {}

    @abstractmethod
    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return x(t + dt) - x(t), shape (B, D), predicted for the states x, shape (B, D)."""

    @property
    def fits_derivatives(self) -> bool:
        """Whether the current epoch fits the field to derivatives, and not predictions to states."""
        if self.loss.derivative == 0 or self._trainer is None:
            return self.loss.derivative > 0
        return self.current_epoch < self.loss.derivative * (self.trainer.max_epochs or 1)

    def residuals(self, batch: Window) -> Tensor:
        """Return the residuals of the current epoch's objective in the units of the loss.

        Args:
            batch: of W steps, or more where derivatives need a wider stencil.

        Returns:
            shape (B, W, D) for predictions, (B, D) for derivatives.
        """
        if not self.fits_derivatives:
            return self.prediction_residuals(batch)
        middle, target = derivative_samples(batch)
        residuals = batch.dt * cast(Learner, self.learner)(middle) - target
        return residuals * self._weights(target)

    def prediction_residuals(self, batch: Window) -> Tensor:
        """Return the residuals of W recursive predictions in the units of the loss, shape (B, W, D)."""
        window = batch._replace(increments=batch.increments[:, : self.window])
        return recursive_residuals(self.increment, window) * self._weights(window.increments)

    def problem(self, batch: Window) -> LeastSquares:
        """Return the residuals of the current epoch's objective as a problem in the parameters."""
        if self.fits_derivatives:
            middle, target = derivative_samples(batch)
            learner = cast(Learner, self.learner)
            return pointwise_problem(
                self, lambda x: batch.dt * learner(x), middle, target, self._weights(target)
            )
        targets = batch.increments[:, : self.window]
        step = partial(self.increment, dt=batch.dt)
        return recursive_problem(self, step, batch.start, targets, self._weights(targets))

    def _weights(self, targets: Tensor) -> Tensor:
        return self.loss.weights(targets, self.loss_scale)

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
            if batch.share != 1:
                loss = loss * batch.share
        else:
            loss = cast(Any, self.optimizers()).step(lambda: self.problems(batch))
        mean = float(self._mean_of_devices(loss.detach()))
        if not math.isfinite(mean):
            message = (
                f"training: the loss became {mean} in epoch {self.current_epoch}, "
                f"batch {batch_idx}; the last good checkpoint is kept. Try a smaller optimizer.lr or window."
            )
            raise TrainingError(message)
        return loss

    def on_validation_start(self) -> None:
        """Look at the weights that the last step of an epoch left, before any checkpoint holds them."""
        self.require_finite()

    def require_finite(self) -> None:
        """Check the weights, as the loss of a step says nothing of what the step made of them.

        Raises:
            TrainingError: a weight is not finite.
        """
        if all(bool(p.isfinite().all()) for p in self.parameters()):
            return
        message = (
            f"training: weights became nan or inf at step {self.trainer.global_step} in epoch "
            f"{self.current_epoch}; the last good checkpoint is kept. Try a smaller optimizer.lr or window."
        )
        raise TrainingError(message)

    def _mean_of_devices(self, loss: Tensor) -> Tensor:
        if self.trainer.world_size == 1:
            return loss
        return cast(Tensor, self.trainer.strategy.reduce(loss.clone(), reduce_op="mean"))

    def problems(self, batch: Window) -> tuple[LeastSquares, LeastSquares]:
        """Return a fifth of a batch as the problem to step on, and the rest to check the step.

        The check needs no Jacobian and may be large; a small one is noisy and raises the damping. Predictions
        of W steps take a W-th of the windows, so that the number of residuals stays the same.
        """
        steps = 1 if self.fits_derivatives else self.window
        split = max(1, batch.start.shape[0] // (5 * steps))
        step, check = (
            self.problem(Window(batch.start[part], batch.increments[part], batch.dt))
            for part in (slice(None, split), slice(split, None))
        )
        return step, check

    def validation_step(self, batch: Window, batch_idx: int) -> None:
        """Log the loss of W predictions `val/loss`, and `val/one_step`, the rms residual of single steps."""
        del batch_idx
        size = float(batch.start.shape[0] if batch.share else 0)  # Lightning rounds the mean of integers
        residuals = self.prediction_residuals(batch)
        options: dict[str, Any] = {"batch_size": size, "on_epoch": True, "logger": False, "sync_dist": True}
        self.log("val/loss", self.loss(residuals), **options)
        self.log("val/one_step", residuals[:, 0].square().mean().sqrt(), **options)
