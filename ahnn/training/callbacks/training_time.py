"""Duration of a training run, including the time before it was resumed."""

from __future__ import annotations

import time
from typing import Any

from lightning import Callback, LightningModule, Trainer


class TrainingTime(Callback):
    """Clock of the fit, saved in checkpoints."""

    def __init__(self) -> None:
        self.before, self.begun = 0.0, time.monotonic()

    @property
    def seconds(self) -> float:
        """Seconds of the fit so far, summed over all processes that ran it."""
        return self.before + time.monotonic() - self.begun

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Start the clock."""
        self.begun = time.monotonic()

    def state_dict(self) -> dict[str, Any]:
        """Return the seconds so far."""
        return {"seconds": self.seconds}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continue from the seconds of a checkpoint."""
        self.before = float(state_dict["seconds"])


def timed_fit(trainer: Trainer, *arguments: Any, **options: Any) -> float:
    """Call `trainer.fit`; return its duration in seconds, including the time before it was resumed."""
    clock = TrainingTime()
    trainer.callbacks.insert(0, clock)  # pyright: ignore[reportAttributeAccessIssue] - not in Lightning's types
    trainer.fit(*arguments, **options)
    return clock.seconds
