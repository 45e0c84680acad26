"""Check that a run can resume from a checkpoint, made on copies before the run is modified."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch.utilities.migration.utils import migrate_checkpoint
from torch import Tensor
from torch.optim import Optimizer

from ahnn.checkpoints import read_checkpoint, require_same
from ahnn.errors import UserError
from ahnn.training.steppers import stepper_of

STATES = "optimizer_states"
NEEDED = {"state_dict": dict, STATES: list, "lr_schedulers": list, "loops": dict, "callbacks": dict}
NEEDED |= {"epoch": int, "global_step": int}
"""Parts of a checkpoint that Lightning reads without checking them."""


def require_resumable(path: Path, model: Any, trainer: Any) -> None:
    """Check that a checkpoint is present, intact, and of the same training run.

    Args:
        path: path of the checkpoint.
        model: model to be trained.
        trainer: trainer with its callbacks.

    Raises:
        UserError: the checkpoint is not; the message names the difference.
    """
    content = read_checkpoint(path)
    parts = ("data", "settings")
    wanted, found = ({k: known.get(k, {}) for k in parts} for known in (model.about, content["ahnn"]))
    run = path.parent.parent if path.parent.name == "checkpoints" else "DIR"
    remedy = f"To train the same model further, start a new run: weights={run} run=NEW"
    require_same(f"checkpoint {path}", found, wanted, remedy)
    require_restorable(f"checkpoint {path}", model, trainer, content)


def require_restorable(who: str, model: Any, trainer: Any, content: dict[str, Any]) -> None:
    """Restore a checkpoint into copies and take a step, after comparing all tensors.

    Fused kernels do not check shapes: a wrong shape would write out of bounds.

    Args:
        who: name of the checkpoint, for messages.
        model: model to be trained; it is not modified.
        trainer: trainer; its callbacks and loops load their states.
        content: content of the checkpoint, as written by Lightning.

    Raises:
        UserError: a tensor has a different name, shape or type, or a part is missing.
    """
    if missing := [key for key, kind in NEEDED.items() if not isinstance(content.get(key), kind)]:
        message = f"{who}: expected a complete checkpoint; received one without {', '.join(missing)}"
        raise UserError(message)
    (fresh, schedulers), (stepped, _) = _optimisation(model), _optimisation(model)
    try:
        for part in stepped:
            _step(part)
        known = layout(dict(model.state_dict())) | layout([part.state_dict() for part in stepped], STATES)
        found = layout(content["state_dict"]) | layout(content[STATES], STATES)
        owners = {name.rpartition(".")[0] for name in found}  # parameters without gradients have no state
        needed = {n for n in known if not n.startswith(STATES) or n.rpartition(".")[0] in owners}
        wrong = sorted(name for name in needed | found.keys() if known.get(name) != found.get(name))
        if wrong:
            message = (
                f"{who}: expected the shapes of this model; received different shapes of {', '.join(wrong)}"
            )
            raise UserError(message)
        for parts, states in ((fresh, content[STATES]), (schedulers, content["lr_schedulers"])):
            for k, part in enumerate(parts):
                part.load_state_dict(states[k])
        for part in fresh:
            _step(part)
        for part in trainer.callbacks:
            if part.state_key in content["callbacks"]:
                part.load_state_dict(content["callbacks"][part.state_key])
        trainer.fit_loop.load_state_dict(content["loops"]["fit_loop"])
        migrate_checkpoint({"pytorch-lightning_version": content["pytorch-lightning_version"]})
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        message = f"{who}: expected a complete checkpoint; received {error!r}"
        raise UserError(message) from error


def layout(value: Any, name: str = "") -> dict[str, tuple[torch.Size, torch.dtype]]:
    """Return shape and type of every tensor in nested values, by its dotted name."""
    if isinstance(value, Tensor):
        return {name: (value.shape, value.dtype)}
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    parts = (layout(item, f"{name}.{key}".removeprefix(".")) for key, item in items)
    return {key: found for part in parts for key, found in part.items()}


def _optimisation(model: Any) -> tuple[list[Any], list[Any]]:
    """Build the optimisers of a copy of the model, one or several, and its scheduler, if any."""
    configured = copy.deepcopy(model).configure_optimizers()
    if not isinstance(configured, dict):
        return (configured if isinstance(configured, list) else [configured]), []
    return [configured["optimizer"]], [configured["lr_scheduler"]["scheduler"]]


def _step(optimizer: Optimizer) -> None:
    """Take a step with zero gradients, for gradient-based optimisers."""
    if stepper_of(optimizer).automatic:
        for group in optimizer.param_groups:
            for parameter in group["params"]:
                parameter.grad = torch.zeros_like(parameter)
        optimizer.step()
