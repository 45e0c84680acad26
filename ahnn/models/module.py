"""Abstract LightningModule: dynamics, objectives and optimiser steps."""

from __future__ import annotations

import warnings
from abc import ABC
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, cast

import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.strategies import DDPStrategy
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from ahnn.dynamics import Dynamics, has_field
from ahnn.errors import UserError
from ahnn.statistics import Statistics
from ahnn.training import (
    FirstOrder,
    Objective,
    Stepper,
    make_curriculum,
    stepper_of,
)
from ahnn.training.finite import require_finite_loss, require_finite_weights
from ahnn.types import Flow, TimeStep, Window

DEVICES = ("cpu", "cuda")
"""Types of devices for training on measurements, which needs float64."""
STAGED = ("val/loss", "val/lost")
"""Metrics logged by validations on measurements."""
LOOKS = 50
"""Number of steps between checks of the loss, which synchronise the device; non-finite losses persist."""


class Optimisation(NamedTuple):
    """Factories of the optimiser and its scheduler, which belong to a training run, not to a model."""

    optimizer: Callable[[Iterable[nn.Parameter]], Optimizer]
    scheduler: Callable[[Optimizer], LRScheduler] | None


class AbstractModel(LightningModule, ABC):
    """LightningModule for training dynamics.

    Final subclasses define dynamics and objective in their constructor and override nothing else.

    Args:
        dynamics: dynamics to be trained.
        dof: degrees of freedom n.
        window: number W of recursive prediction steps in the loss.
        loss: options of `LossOptions`, or of `SegmentOptions` for measurements.

    Raises:
        UserError: a loss on derivatives or on measurements, for dynamics without a field.
    """

    def __init__(self, dynamics: Dynamics, dof: int, window: int, loss: dict[str, Any]) -> None:
        super().__init__()
        received = {key: loss[key] for key in ("derivative", "stages") if loss.get(key)}
        if received and not has_field(dynamics):
            message = f"model: expected loss=recursive, since a map has no field; received {received}"
            raise UserError(message)
        if loss.get("derivative") and dynamics.clock > 1:
            message = (
                "loss.derivative: expected 0 with controls, whose jumps prevent differences of samples; "
                f"received {loss['derivative']}. Use loss=recursive"
            )
            raise UserError(message)
        self.dynamics = dynamics
        self.loss, self.curriculum = make_curriculum(2 * (dof + dynamics.clock), window, loss)
        self.dof, self.window = dof, window
        self.stepper: Stepper = FirstOrder()
        self._optimisation: Optimisation | None = None
        self._recorded: Stepper | None = None
        self._about: dict[str, Any] = {}

    def train_by(self, optimisation: Optimisation, about: Mapping[str, Any]) -> None:
        """Set the optimiser of a training run, and its checkpoint metadata."""
        self._optimisation, self._about = optimisation, {**about}

    def learns_from(self, **about: Any) -> None:
        """Add metadata about the data to checkpoints, once available."""
        self._about |= about

    def step_by(self, recorded: Stepper) -> None:
        """Use recorded gradients instead of autograd in the steps of a first-order optimiser."""
        self._recorded = recorded

    @property
    def about(self) -> Mapping[str, Any]:
        """Checkpoint metadata of the training, plain values."""
        return MappingProxyType(self._about)

    @property
    def optimisation(self) -> Optimisation:
        """Optimiser and scheduler."""
        assert self._optimisation is not None, "call `train_by` before fit"
        return self._optimisation

    @property
    def objective(self) -> Objective:
        """Objective of the current epoch, or of the first without a trainer."""
        if self._trainer is None:
            return self.curriculum.phases[0].objective
        return self.curriculum.at(self.current_epoch, self.trainer.max_epochs or 1)

    def forward(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Propagate states x, shape (B, D), over dt; return (B, D)."""
        return self.dynamics(x, dt)

    def flow(self) -> Flow:
        """Return a float64 copy of the dynamics as a flow, for evaluation and filters."""
        return self.dynamics.frozen()

    @torch.no_grad()
    def calibrate(self, statistics: Statistics) -> None:
        """Fit scalings, units and the unit of the loss to the training split."""
        self.dynamics.fit(statistics)
        cast(Any, self.loss).fit(statistics)

    def configure_optimizers(self) -> Any:
        """Return optimiser and per-epoch scheduler for Lightning."""
        optimizer = self.optimisation.optimizer(self.dynamics.parameters())
        self.stepper = self.stepper_for(optimizer)
        self.automatic_optimization = self.stepper.automatic
        if self.optimisation.scheduler is None or not self.automatic_optimization:
            return optimizer
        scheduler = self.optimisation.scheduler(optimizer)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": scheduler, "interval": "epoch"}}

    def stepper_for(self, optimizer: Optimizer) -> Stepper:
        """Return the stepper of an optimiser."""
        own = stepper_of(optimizer)
        return self._recorded if self._recorded is not None and isinstance(own, FirstOrder) else own

    def check(self, trainer: Trainer) -> None:
        """Test optimiser and scheduler before data generation, and check the trainer with the stepper.

        Raises:
            UserError: incompatible settings.
        """
        if self.curriculum.span is None:
            self._check_stages(trainer)
        configured = self.configure_optimizers()
        self.stepper.check(trainer, self.dynamics)
        optimizer = configured["optimizer"] if isinstance(configured, dict) else configured
        if look := getattr(optimizer, "check", None):
            look([phase.objective for phase in self.curriculum.phases])
        if isinstance(trainer.strategy, DDPStrategy) and not trainer.strategy._ddp_kwargs:
            message = (
                "trainer.strategy: expected one that allows unused parameters; received ddp. Use trainer=ddp"
            )
            raise UserError(message)
        if not isinstance(configured, dict):
            return
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the warning that the optimiser has not stepped yet
                configured["lr_scheduler"]["scheduler"].step()
        except (ArithmeticError, TypeError, ValueError) as error:
            message = f"scheduler: expected settings that allow a step; received: {error}"
            raise UserError(message) from error

    def _check_stages(self, trainer: Trainer) -> None:
        """Reject what measurements do not support: several devices, one without float64, unlogged metrics."""
        device = trainer.strategy.root_device.type
        asked = {"trainer.accelerator": (device, DEVICES), "trainer.devices": (trainer.world_size, (1,))}
        for callback in trainer.callbacks:  # pyright: ignore[reportAttributeAccessIssue]
            if isinstance(monitor := getattr(callback, "monitor", None), str):
                asked[f"{type(callback).__name__}.monitor"] = monitor, STAGED
        for name, (received, fitting) in asked.items():
            if received not in fitting:
                expected = " or ".join(map(str, fitting))
                message = f"{name}: expected {expected} for training on measurements; received {received}"
                raise UserError(message)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add metadata of dynamics and data, and the latest validation loss, as plain values."""
        loss = self.trainer.callback_metrics.get("val/loss")
        known = {**self.about, "dynamics": self.dynamics.spec}
        checkpoint["ahnn"] = {**known, "val_loss": None if loss is None else float(loss)}

    def training_step(self, batch: Any, batch_idx: int) -> Tensor:
        """Return the loss of one batch.

        Raises:
            TrainingError: the loss is not finite.
        """
        optimizer = None if self.automatic_optimization else self.optimizers()
        loss = self.stepper.step(self.objective, self.loss, self.dynamics, batch, optimizer)
        if loss.device.type == "cpu" or batch_idx % LOOKS == 0:
            mean = float(self._mean_of_devices(loss.detach()))
            require_finite_loss(mean, f"in epoch {self.current_epoch}, batch {batch_idx}")
        return loss

    def on_validation_start(self) -> None:
        """Check that the weights after an epoch are finite, before a checkpoint is written."""
        where = f"at step {self.trainer.global_step} in epoch {self.current_epoch}"
        require_finite_weights(self.dynamics, where)

    def _mean_of_devices(self, loss: Tensor) -> Tensor:
        if self.trainer.world_size == 1:
            return loss
        return cast(Tensor, self.trainer.strategy.reduce(loss.clone(), reduce_op="mean"))

    def validation_step(self, batch: Any, batch_idx: int) -> None:
        """Log the metrics of the validation objective: `val/loss`, and `val/one_step` or `val/lost`."""
        size = len(batch.start) if isinstance(batch, Window) else len(batch.values)
        size = float(size if getattr(batch, "weight", 1) else 0)  # Lightning rounds the mean of integers
        options: dict[str, Any] = {"batch_size": size, "on_epoch": True, "logger": False, "sync_dist": True}
        for name, value in self.curriculum.judge.validation(self.dynamics, batch).items():
            self.log(f"val/{name}", value, **options)
