"""Training progress: one bar on a terminal, one line per epoch in a log."""

from __future__ import annotations

import logging
import time
from typing import Any, cast

from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import ProgressBar
from rich.progress import Progress, TaskID, TextColumn

from ahnn.progress import progress_bar
from ahnn.training.runtime_estimate import amounts

REFRESH_SECONDS = 0.5
log = logging.getLogger(__name__)


class TrainingProgress(ProgressBar):
    """Progress bar for the entire fit, updated twice a second and without cost in between.

    If standard error is not a terminal, each epoch is logged as a line.
    """

    def __init__(self) -> None:
        super().__init__()
        self._bar: Progress | None = None
        self._task = TaskID(0)
        self._due = 0.0
        self._began = 0.0
        self._first = 0
        self._amounts: list[float] = []
        self._shown = True

    def disable(self) -> None:
        """Disable output: Lightning calls this in all processes but the first."""
        self._shown = False

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Open the bar at the step where training starts or resumes."""
        if not self._shown:
            return
        self._bar = progress_bar(TextColumn("{task.fields[note]}"))
        total = int(trainer.num_training_batches) * int(trainer.max_epochs or 1)
        self._task = self._bar.add_task("training", total=total, completed=trainer.global_step, note="")
        self._bar.start()
        self._began = time.monotonic()
        self._first = trainer.current_epoch
        if self._bar.disable:
            per_epoch, epochs = int(trainer.num_training_batches), range(trainer.max_epochs or 1)
            self._amounts = amounts(cast(Any, trainer).datamodule, per_epoch, epochs)

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Update the bar when due."""
        if self._bar is None or time.monotonic() < self._due:
            return
        self._due = time.monotonic() + REFRESH_SECONDS
        validation = trainer.callback_metrics.get("val/loss")
        note = f"epoch {trainer.current_epoch + 1}/{trainer.max_epochs}  loss {float(outputs['loss']):.2e}"
        if validation is not None:
            note += f"  val {float(validation):.2e}"
        self._bar.update(self._task, completed=trainer.global_step, note=note)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Log the line of an epoch if there is no bar."""
        if self._bar is None or not self._bar.disable or trainer.sanity_checking:
            return
        done, epochs = trainer.current_epoch + 1, int(trainer.max_epochs or 1)
        values = [f"{name} {float(v):.2e}" for name, v in trainer.callback_metrics.items() if "val/" in name]
        elapsed, behind = time.monotonic() - self._began, sum(self._amounts[self._first : done])
        left = elapsed / behind * sum(self._amounts[done:])
        stages = getattr(cast(Any, trainer).datamodule, "stages", None)
        rest = "" if stages is None else ", then the closing stage"
        log.info("epoch %d/%d  %s  about %.0f s left%s", done, epochs, "  ".join(values), left, rest)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Close the bar."""
        self._close()

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:
        """Close the bar, so that the message that follows is readable."""
        self._close()

    def _close(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
