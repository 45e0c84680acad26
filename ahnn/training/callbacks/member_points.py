"""Best weights of each member of an ensemble, in the checkpoints of its own run folder."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import Checkpoint

from ahnn.files import write_atomically
from ahnn.training.callbacks.rollout import ValidationRollout
from ahnn.training.finite import require_finite_loss


class MemberPoints(Checkpoint):
    """Writes best.ckpt of a member after each validation with the smallest value of its metric so far.

    Args:
        folders: run folder of each member.
        monitor: name of the metric.
        rollouts: validation rollouts of each member, as in a separate training run.
    """

    def __init__(self, folders: Sequence[Path], monitor: str, rollouts: Sequence[ValidationRollout]) -> None:
        self.folders, self.monitor, self.rollouts = [*folders], monitor, [*rollouts]
        self.best = [math.inf] * len(folders)
        self.latest = [math.inf] * len(folders)
        self.judged = False

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the checkpoints of the members whose value improved."""
        if trainer.state.fn != "fit":
            return
        ensemble, self.judged = cast(Any, pl_module), True
        zipped = zip(self.folders, ensemble.models, ensemble.scores, self.rollouts, strict=True)
        for k, (folder, model, scores, rollout) in enumerate(zipped):
            error = rollout.judge(trainer, model)
            known = scores if error is None else {**scores, "val/rollout": error}
            self.latest[k] = known[self.monitor]
            if self.latest[k] < self.best[k]:
                self.best[k] = self.latest[k]
                self._write(folder, model, scores["val/loss"], trainer)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Raise if a member had no finite value in any validation, so that it has no best weights."""
        for folder, best, latest in zip(self.folders, self.best, self.latest, strict=True):
            if self.judged and not math.isfinite(best):
                require_finite_loss(latest, f"in every validation ({self.monitor}) of {folder.name}")

    def state_dict(self) -> dict[str, Any]:
        """Return the smallest values so far, and the latest rollouts."""
        return {"best": self.best, "rollouts": [rollout.state_dict() for rollout in self.rollouts]}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the values from a checkpoint."""
        self.best = [*state_dict["best"]]
        for rollout, state in zip(self.rollouts, state_dict["rollouts"], strict=True):
            rollout.load_state_dict(state)

    def _write(self, folder: Path, model: Any, loss: float, trainer: Trainer) -> None:
        known = {**model.about, "dynamics": model.dynamics.spec, "val_loss": loss}
        content = {"state_dict": model.state_dict(), "ahnn": known}
        content |= {"epoch": trainer.current_epoch, "global_step": trainer.global_step}
        buffer = io.BytesIO()
        torch.save(content, buffer)
        path = folder / "checkpoints" / "best.ckpt"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, buffer.getvalue())
