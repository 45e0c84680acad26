"""Checkpoints of a run: the best weights, and the last state for resumption after an interruption."""

from __future__ import annotations

import math
import signal
import threading
from pathlib import Path
from typing import Any

from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import Checkpoint

from ahnn.arguments import Count, checked
from ahnn.errors import TERMINATIONS, Stopped, UserError
from ahnn.training.finite import require_finite_loss, require_finite_weights

MONITORED = ("val/loss", "val/one_step")
"""Metrics logged in every validation; a callback adds the names in its attribute `monitored`."""


def require_monitored(who: str, name: str, trainer: Trainer) -> None:
    """Check before training that a metric will be logged; raises UserError."""
    known = [*MONITORED, *(name for c in trainer.callbacks for name in getattr(c, "monitored", ()))]  # pyright: ignore[reportAttributeAccessIssue]
    if name not in known:
        silent = ", which needs callbacks.rollout.count > 0 (0 in trials of a search)"
        message = f"{who}: expected one of {', '.join(known)}; received {name!r}"
        message += silent if name == "val/rollout" else ""
        raise UserError(message)


@checked
class BestPoint(Checkpoint):
    """Writes best.ckpt after each validation with the smallest value of a metric so far.

    This includes the validation before the first step if training begins with known physics.

    Args:
        folder: folder of best.ckpt. It is not part of the state, so that a run may be moved.
        monitor: name of the logged metric.

    Raises:
        UserError: the metric is not logged; raised before the first step.
    """

    def __init__(self, folder: str, monitor: str) -> None:
        self.path = Path(folder) / "best.ckpt"
        self.monitor = monitor
        self.best = self.latest = math.inf
        self.judged = False

    def check(self, trainer: Trainer) -> None:
        """Check that the metric will be available; raises UserError."""
        require_monitored("callbacks.best.monitor", self.monitor, trainer)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the checkpoint if the value improved."""
        if trainer.state.fn != "fit":
            return
        self.latest, self.judged = float(trainer.callback_metrics[self.monitor]), True
        if self.latest < self.best:
            self.best = self.latest
            trainer.save_checkpoint(self.path)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Raise if no validation had a finite value, so that there are no best weights."""
        if self.judged and not math.isfinite(self.best):
            require_finite_loss(self.latest, f"in every validation ({self.monitor})")

    def state_dict(self) -> dict[str, Any]:
        """Return the smallest value so far."""
        return {"best": self.best}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the smallest value from a checkpoint."""
        self.best = state_dict["best"]


@checked
class ResumePoint(Checkpoint):
    """Writes last.ckpt every few steps, after each validation, and when a scheduler terminates the process.

    It writes none between the last step of an epoch and its validation: Lightning would skip that validation
    on resumption, and the best checkpoint would differ from that of an uninterrupted run. SIGTERM and SIGHUP
    are therefore deferred to the next resumable step; a second signal is not.

    Args:
        folder: folder of last.ckpt.
        every: number of optimiser steps between writes within an epoch.
    """

    def __init__(self, folder: str, every: Count) -> None:
        self.path = Path(folder) / "last.ckpt"
        self.every = every
        self._signal: int | None = None
        self._before: dict[int, Any] = {}

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Install deferred signal handling, for single-process training."""
        if trainer.world_size > 1 or threading.current_thread() is not threading.main_thread():
            return
        for number in TERMINATIONS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._request)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the checkpoint if training ended before its first validation, for later evaluation."""
        if not self.path.exists():
            trainer.save_checkpoint(self.path)

    def teardown(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Restore the signal handlers."""
        while self._before:
            signal.signal(*self._before.popitem())

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Write the checkpoint when due, except on the last batch of an epoch."""
        due = trainer.global_step % self.every == 0 or self._signal is not None
        if due and not trainer.is_last_batch:
            require_finite_weights(pl_module, f"at step {trainer.global_step}")
            self._write(trainer)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the checkpoint at the end of an epoch."""
        if trainer.state.fn == "fit" and not trainer.sanity_checking:
            self._write(trainer)

    def _write(self, trainer: Trainer) -> None:
        trainer.save_checkpoint(self.path)
        if self._signal is not None:
            raise Stopped(self._signal)

    def _request(self, number: int, frame: Any) -> None:
        if self._signal is not None:
            raise Stopped(number)
        self._signal = number
