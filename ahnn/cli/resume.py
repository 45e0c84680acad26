"""The checkpoint to resume from: whole, of the same training, and of a shape that its optimiser takes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from torch import Tensor

from ahnn.checkpoints import read_checkpoint, require_same
from ahnn.errors import UserError

if TYPE_CHECKING:
    from ahnn.models import AbstractModel

NEEDED = ("state_dict", "optimizer_states", "lr_schedulers", "loops", "callbacks", "epoch", "global_step")
"""What Lightning takes from a checkpoint without asking whether it is there."""
LIKE_WEIGHTS = ("exp_avg", "exp_avg_sq", "max_exp_avg_sq", "momentum_buffer")
"""States of an optimiser that must have the shape of their parameter: fused kernels do not look."""


def resume_point(ckpt: str | None, model: AbstractModel, folder: Path) -> Path | None:
    """Return the checkpoint to resume from, or None.

    Args:
        ckpt: None, `last`, `best`, or a path.
        model: what is going to be trained; the checkpoint must be of the same training.
        folder: where checkpoints of this run are.

    Raises:
        UserError: the checkpoint is missing, damaged, or of another training.
    """
    if ckpt is None:
        return None
    path = folder / f"{ckpt}.ckpt" if ckpt in ("last", "best") else Path(ckpt)
    content = read_checkpoint(path)
    if missing := [key for key in NEEDED if key not in content]:
        message = f"checkpoint {path}: expected one to resume from; received one without {', '.join(missing)}"
        raise UserError(message)
    parts = ("data", "settings")
    wanted, received = ({k: known.get(k, {}) for k in parts} for known in (model.about, content["ahnn"]))
    require_same(f"checkpoint {path}", wanted, received)
    _require_shapes(path, model, content)
    return path


def _require_shapes(path: Path, model: AbstractModel, content: dict[str, Any]) -> None:
    """Compare every tensor with what it will be loaded into; raises UserError for another shape or name."""
    own = {name: tuple(tensor.shape) for name, tensor in model.state_dict().items()}
    found = {name: tuple(getattr(tensor, "shape", ())) for name, tensor in content["state_dict"].items()}
    wrong = sorted(name for name in own.keys() | found.keys() if own.get(name) != found.get(name))
    parameters = list(model.dynamics.parameters())
    for states in content["optimizer_states"]:
        for index, state in states.get("state", {}).items():
            shape = tuple(parameters[index].shape) if index in range(len(parameters)) else None
            wrong += [
                f"{key} of parameter {index}"
                for key in LIKE_WEIGHTS
                if key in state and not _is_shaped(state[key], shape)
            ]
    if wrong:
        message = (
            f"checkpoint {path}: expected the shapes of this model; received others of {', '.join(wrong)}"
        )
        raise UserError(message)


def _is_shaped(value: Any, shape: tuple[int, ...] | None) -> bool:
    return isinstance(value, Tensor) and tuple(value.shape) == shape
