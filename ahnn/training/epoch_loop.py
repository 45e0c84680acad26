"""Lightning's loop over batches, without what is done between two steps for nobody.

Of a step of a small network Lightning's own loop is a third, with its `barebones` trainer too: forty calls of
hooks, most of which nobody defines, each in the context of a profiler that measures nothing. This loop does
the same in the same order, hooks that somebody defines included; what it does not know it leaves to
Lightning's.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.loops.training_epoch_loop import _TrainingEpochLoop
from lightning.pytorch.plugins.precision import Precision
from lightning.pytorch.profilers import PassThroughProfiler
from lightning.pytorch.strategies import SingleDeviceStrategy
from lightning.pytorch.utilities.model_helpers import is_overridden
from torch import Tensor
from torch.optim import Optimizer

HOOKS = (
    "on_before_zero_grad",
    "on_before_backward",
    "on_after_backward",
    "on_before_optimizer_step",
    "on_train_batch_end",
)
"""Of a step, told to callbacks and to the module."""
LIGHTNINGS = (
    "on_train_batch_start",  # which may end the epoch
    "backward",
    "optimizer_step",
    "optimizer_zero_grad",
    "on_before_batch_transfer",
    "on_after_batch_transfer",
)
"""Who changes one of these gets Lightning's loop."""


class EpochLoop(_TrainingEpochLoop):
    """The batches of an epoch.

    Attributes:
        heard: who defines a hook of a step, by its name; None leaves steps to Lightning.
    """

    heard: dict[str, list[Callable[..., Any]]] | None = None

    @classmethod
    def take(cls, trainer: Trainer) -> None:
        """Put this loop in the place of Lightning's."""
        own = trainer.fit_loop.epoch_loop
        trainer.fit_loop.epoch_loop = cls(trainer, own.min_steps, own.max_steps)

    def on_run_start(self, data_fetcher: Any) -> None:
        """Begin an epoch, and look who listens."""
        super().on_run_start(data_fetcher)
        trainer: Any = self.trainer
        data, moves = trainer.datamodule, "transfer_batch_to_device"
        self._mover = data if is_overridden(moves, data) else trainer.lightning_module
        alone = not any(listeners(trainer, hook) for hook in LIGHTNINGS)
        known = alone and knows(trainer)
        self.heard = {hook: listeners(trainer, hook) for hook in HOOKS} if known else None

    def advance(self, data_fetcher: Any) -> None:
        """Take one step."""
        if self.heard is None or self.restarting:
            return super().advance(data_fetcher)
        self.val_loop.restarting = False
        batch, index = next(data_fetcher)[0], self.batch_idx + 1
        trainer: Any = self.trainer
        progress = self.batch_progress
        progress.is_last_batch = data_fetcher.done
        batch = self._mover.transfer_batch_to_device(batch, trainer.strategy.root_device, 0)
        progress.increment_ready()
        trainer._logger_connector.on_batch_start(batch)
        progress.increment_started()
        loss = self._step(batch, index)
        progress.increment_processed()
        self.update_lr_schedulers("step", update_plateau_schedulers=False)
        if self._num_ready_batches_reached():
            self.update_lr_schedulers("epoch", update_plateau_schedulers=False)
        self._tell("on_train_batch_end", {"loss": loss}, batch, index)
        trainer._logger_connector.on_batch_end()
        progress.increment_completed()
        return trainer._logger_connector.update_train_step_metrics()

    def _step(self, batch: Any, index: int) -> Tensor:
        """Let the optimiser take a step, and return the loss before it."""
        trainer: Any = self.trainer
        module, found = trainer.lightning_module, []
        optimizer, progress = trainer.optimizers[0], self.automatic_optimization.optim_progress.optimizer

        def closure() -> Tensor:
            with torch.enable_grad():
                module._current_fx_name = "training_step"
                loss = module.training_step(batch, index)
                module._current_fx_name = None
                found[:] = [loss.detach().clone()]
                self._zero_gradients(optimizer)
                self._tell("on_before_backward", loss)
                loss.backward()
                self._tell("on_after_backward")
            self._tell("on_before_optimizer_step", optimizer)
            if value := trainer.gradient_clip_val:
                algorithm = trainer.gradient_clip_algorithm
                module.configure_gradient_clipping(optimizer, value, algorithm)
            return loss

        progress.step.increment_ready()
        optimizer.step(closure)
        progress.step.increment_completed()
        return found[0]

    def _zero_gradients(self, optimizer: Optimizer) -> None:
        progress = self.automatic_optimization.optim_progress.optimizer.zero_grad
        self._tell("on_before_zero_grad", optimizer)
        progress.increment_ready()
        progress.increment_started()
        optimizer.zero_grad()
        progress.increment_completed()

    def _tell(self, hook: str, *arguments: Any) -> None:
        """Call a hook of those that define it."""
        assert self.heard is not None
        for listener in self.heard[hook]:
            self.trainer.lightning_module._current_fx_name = hook
            listener(*arguments)
            self.trainer.lightning_module._current_fx_name = None


def knows(trainer: Any) -> bool:
    """Return whether there is nothing in a training but what this loop does."""
    return (
        trainer.lightning_module.automatic_optimization
        and trainer.accumulate_grad_batches == 1
        and type(trainer.strategy) is SingleDeviceStrategy
        and type(trainer.precision_plugin) is Precision
        and type(trainer.profiler) is PassThroughProfiler
    )


def listeners(trainer: Any, hook: str) -> list[Callable[..., Any]]:
    """Return a hook of the callbacks that define it, in their order, then of module and data if they do."""
    module, data = trainer.lightning_module, trainer.datamodule
    callbacks = [c for c in trainer.callbacks if hasattr(c, hook) and is_overridden(hook, c, Callback)]
    own = [getattr(module, hook)] if is_overridden(hook, module, LightningModule) else []
    own += [getattr(data, hook)] if hasattr(data, hook) and is_overridden(hook, data) else []
    return [*(partial(getattr(c, hook), trainer, module) for c in callbacks), *own]
