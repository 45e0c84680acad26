"""Where a training begins: in a new folder, or at the checkpoint of the same training."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ahnn.checkpoints import read_checkpoint, require_same
from ahnn.errors import UserError
from ahnn.training.restore import require_restorable

if TYPE_CHECKING:
    from lightning import Trainer

    from ahnn.models import AbstractModel


def require_new(folder: Path, ckpt: str | None) -> None:
    """Check that a training from the start replaces no other.

    Raises:
        UserError: the folder holds checkpoints.
    """
    found = sorted(path.name for path in (folder / "checkpoints").glob("*.ckpt"))
    if found and ckpt is None:
        message = (
            f"run {folder}: expected a folder without checkpoints; received one with {', '.join(found)}. "
            "Resume with ckpt=last, or choose another run="
        )
        raise UserError(message)


def resume_point(ckpt: str | None, model: AbstractModel, trainer: Trainer, folder: Path) -> Path | None:
    """Return the checkpoint to resume from, or None.

    Args:
        ckpt: None, `last`, `best`, or a path.
        model: what is going to be trained; the checkpoint must be of the same training.
        trainer: what is going to train it, with its callbacks.
        folder: where checkpoints of this run are.

    Raises:
        UserError: the checkpoint is missing, damaged, or of another training.
    """
    if ckpt is None:
        return None
    path = folder / f"{ckpt}.ckpt" if ckpt in ("last", "best") else Path(ckpt)
    content = read_checkpoint(path)
    parts = ("data", "settings")
    wanted, received = ({k: known.get(k, {}) for k in parts} for known in (model.about, content["ahnn"]))
    require_same(f"checkpoint {path}", wanted, received)
    require_restorable(f"checkpoint {path}", model, trainer, content)
    return path
