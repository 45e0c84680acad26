"""The two checkpoints of a run: the best weights, and the point to resume from after an interruption."""

from __future__ import annotations

import math
import signal
import threading
from pathlib import Path
from typing import Any

from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import Checkpoint

from ahnn.arguments import Count, checked
from ahnn.errors import Stopped, UserError
from ahnn.training.finite import require_finite_loss, require_finite_weights

MONITORED = ("val/loss", "val/one_step")
"""What every model logs in a validation; a callback adds the names in its `monitored`."""


def require_monitored(who: str, name: str, trainer: Trainer) -> None:
    """Check before a training that somebody will log a value; raises UserError."""
    known = [*MONITORED, *(name for c in trainer.callbacks for name in getattr(c, "monitored", ()))]  # pyright: ignore[reportAttributeAccessIssue]
    if name not in known:
        message = f"{who}: expected one of {', '.join(known)}; received {name!r}"
        raise UserError(message)


@checked
class BestPoint(Checkpoint):
    """Writes best.ckpt after each validation whose value is the smallest so far.

    A validation before the first step, as a training has that begins with known physics, is one of them.

    Args:
        folder: where best.ckpt is written. It is no part of the state, so that a run may be moved.
        monitor: logged value.

    Raises:
        UserError: nothing logs the monitored value; raised before the first step.
    """

    def __init__(self, folder: str, monitor: str) -> None:
        self.path = Path(folder) / "best.ckpt"
        self.monitor = monitor
        self.best = self.latest = math.inf
        self.judged = False

    def check(self, trainer: Trainer) -> None:
        """Check that the value will be there; raises UserError."""
        require_monitored("callbacks.best.monitor", self.monitor, trainer)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write if it is better."""
        del pl_module
        if trainer.state.fn != "fit":
            return
        self.latest, self.judged = float(trainer.callback_metrics[self.monitor]), True
        if self.latest < self.best:
            self.best = self.latest
            trainer.save_checkpoint(self.path)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Stop where no validation had a finite value: then no weights are the best."""
        del trainer, pl_module
        if self.judged and not math.isfinite(self.best):
            require_finite_loss(self.latest, f"in every validation ({self.monitor})")

    def state_dict(self) -> dict[str, Any]:
        """Return the smallest value so far."""
        return {"best": self.best}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take the smallest value from a checkpoint."""
        self.best = state_dict["best"]


@checked
class ResumePoint(Checkpoint):
    """Writes last.ckpt every few steps, after each validation, and when a scheduler ends the process.

    Never between the last step of an epoch and its validation: Lightning would skip that validation when it
    goes on from there, and the best checkpoint would differ from that of an uninterrupted run. SIGTERM and
    SIGHUP therefore wait for the next step that may be resumed from; a second one does not.

    Args:
        folder: where last.ckpt is written.
        every: optimiser steps between two writes within an epoch.
    """

    def __init__(self, folder: str, every: Count) -> None:
        self.path = Path(folder) / "last.ckpt"
        self.every = every
        self._signal: int | None = None
        self._before: dict[int, Any] = {}

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Wait with signals, where one process is all there is."""
        del pl_module
        if trainer.world_size > 1 or threading.current_thread() is not threading.main_thread():
            return
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._request)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write where a training ended before its first validation, so that there are weights to judge."""
        del pl_module
        if not self.path.exists():
            trainer.save_checkpoint(self.path)

    def teardown(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Give signals back."""
        del trainer, pl_module, stage
        while self._before:
            signal.signal(*self._before.popitem())

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Write when due, but not on the last batch of an epoch."""
        del outputs, batch, batch_idx
        due = trainer.global_step % self.every == 0 or self._signal is not None
        if due and not trainer.is_last_batch:
            require_finite_weights(pl_module, f"at step {trainer.global_step}")
            self._write(trainer)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write at the end of an epoch."""
        del pl_module
        if trainer.state.fn == "fit" and not trainer.sanity_checking:
            self._write(trainer)

    def _write(self, trainer: Trainer) -> None:
        trainer.save_checkpoint(self.path)
        if self._signal is not None:
            raise Stopped(self._signal)

    def _request(self, number: int, frame: Any) -> None:
        del frame
        if self._signal is not None:
            raise Stopped(number)
        self._signal = number
