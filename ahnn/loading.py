"""Loading of trained models, from run folders or the package, as a `Run`."""

from __future__ import annotations

import logging
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from ahnn.arguments import checked, flatten
from ahnn.checkpoints import Weights, read_weights
from ahnn.contents import read_json
from ahnn.dynamics import make_dynamics
from ahnn.dynamics.sizes import fillable
from ahnn.errors import UserError
from ahnn.pretrained import names, shipped
from ahnn.runs import Run
from ahnn.stored import SAVED, read_about
from ahnn.types import Space
from ahnn.uncertainty import domain_of, load_uncertainty
from ahnn.uncertainty.posterior import FILE

log = logging.getLogger(__name__)
BAD = ("not good", "WORTHLESS", "poor", "worse")
"""Beginnings of the verdict on a model that is not good."""
MEMBER = re.compile(r"seed_(\d+)")
"""Folder name of one of several seeds, inside the folder of the run."""


@checked
def load(run: str | Path, ckpt: str = "best") -> Run:
    """Load a trained model.

    Args:
        run: a run folder, or the name of a model shipped with the package.
        ckpt: `best`, `last`, or the path of a checkpoint.

    Raises:
        UserError: the run is missing, or its weights or their covariance are damaged.
    """
    folder = Path(run)
    if not folder.exists() and str(run) in names():
        folder = shipped(str(run))
    if not folder.is_dir():
        message = f"run: expected a run folder or one of {', '.join(names())}; received {str(run)!r}"
        raise UserError(message)
    require_single(folder, ckpt)
    path = weights_path(folder, ckpt)
    weights = read_weights(path)
    if ckpt == "best" and path.stem == "last":
        require_last(folder, weights.about)
    trained = made(weights, folder)
    known = load_uncertainty(folder, trained.dynamics.state_dict())
    if known is None:
        return trained
    count, received = sum(p.numel() for p in trained.dynamics.parameters()), len(known.offset)
    if count != received:
        message = f"{folder / FILE}: expected a covariance of {count} parameters; received {received}"
        raise UserError(message)
    if known.unfinished:
        warn_once(f"run {folder}: {known.unfinished}")
    dynamics, uncertainty = known.taken(trained.dynamics)
    return replace(trained, dynamics=dynamics.eval().requires_grad_(False), uncertainty=uncertainty)


def unfinished_training(folder: Path) -> str:
    """Return a remark on a run whose training was interrupted, before its results; "" for others.

    A training leaves its last weights from its first epoch on, and `metrics.json` at the end.
    """
    if not (folder / "checkpoints" / "last.ckpt").exists() or (folder / "metrics.json").exists():
        return ""
    return (
        f"run {folder}: the training was not finished, so its weights are preliminary and carry no "
        f"uncertainty. Resume it: repeat its command with run={folder} ckpt=last"
    )


def judged_training(folder: Path) -> str:
    """Return a remark on a run whose training was not finished or whose model was judged to be bad, or ""."""
    if remark := unfinished_training(folder):
        return remark
    try:
        head, *more = read_json(folder / "metrics.json")["plugins"]["verdict"]["findings"]
    except (UserError, ValueError, KeyError, TypeError):
        return ""  # saved or shipped models, and runs of older versions
    word, _, measure = str(head).partition(": ")
    if not word.startswith(BAD):
        return ""
    reason, *_ = [*(text for text in more if not text.startswith("budget=")), measure]
    return f"run {folder}: its evaluation judged it {word}: {reason.partition(';')[0]}"


@cache
def warn_once(text: str) -> None:
    """Log a warning, once in a process: a command may load a run several times."""
    log.warning("%s", text)


def member_folders(folder: Path) -> list[Path]:
    """Return the run folders of the members of an ensemble, by seed; none for other folders."""
    numbered = ((MEMBER.fullmatch(path.name), path) for path in folder.glob("seed_*"))
    found = [(int(match[1]), path) for match, path in numbered if match and weights_path(path).exists()]
    return [path for _, path in sorted(found)]


def require_single(folder: Path, ckpt: str) -> None:
    """Raise UserError for the folder of several runs, unless `ckpt` is the path of weights."""
    if ckpt in ("best", "last") and (folders := member_folders(folder)):
        message = (
            f"run {folder}: expected the folder of one run; received that of {len(folders)} members. Name "
            f"one, such as {folders[0]}, or use ahnn.load_ensemble"
        )
        raise UserError(message)


def weights_path(folder: Path, ckpt: str = "best") -> Path:
    """Return the path of a run's weights.

    Args:
        folder: folder of the run.
        ckpt: `best` (the last weights if none were selected), `last`, or a path.
    """
    if ckpt not in ("best", "last"):
        return Path(ckpt)
    here = folder / "checkpoints"
    candidates = [here / f"{ckpt}.ckpt", folder / SAVED]
    if ckpt == "best":
        candidates.append(here / "last.ckpt")
    return next((path for path in candidates if path.exists()), candidates[0])


def require_last(folder: Path, about: dict[str, Any]) -> None:
    """Log that the last weights serve as the best, because no validation selected any.

    Raises:
        UserError: weights were selected but are missing.
    """
    monitor = flatten(about).get("settings.callbacks.best.monitor")
    if monitor is not None and about.get("val_loss") is not None:
        message = (
            f"run {folder}: expected checkpoints/best.ckpt, the weights with the smallest {monitor}; "
            "received none. Set ckpt=last to use the last weights"
        )
        raise UserError(message)
    log.warning("run %s: no validation chose the best weights; the last ones are used", folder)


def made(weights: Weights, folder: Path) -> Run:
    """Build a run from weights.

    Raises:
        UserError: the weights have no metadata, belong to other dynamics, or are not finite.
    """
    about, space = read_about(f"run {folder}: weights", weights.about)
    try:
        with fillable(weights.state):
            dynamics = make_dynamics(**about.dynamics)
        require_controls(dynamics.clock, space)
        domain = domain_of(weights.about, len(space.components))
    except Exception as error:  # third-party classes may raise anything for invalid arguments
        reason = error if isinstance(error, UserError) else repr(error)
        message = f"run {folder}: expected weights with a description; received: {reason}"
        raise UserError(message) from error
    try:
        dynamics.double().load_state_dict(weights.state)
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        message = (
            f"run {folder}: expected the weights of its model; received weights of a different model "
            f"({reason})"
        )
        raise UserError(message) from error
    if not all(bool(tensor.isfinite().all()) for tensor in weights.state.values()):
        message = f"run {folder}: expected finite weights; received nan or inf. Use another checkpoint"
        raise UserError(message)
    return Run(dynamics.eval().requires_grad_(False), space, about.dt, weights.about, folder, domain)


def require_controls(clock: int, space: Space) -> None:
    """Raise UserError for dynamics with k = `clock` clock coordinates other than the space's controls."""
    if clock > 1 and clock - 1 != len(space.controls):
        names = ", ".join(space.controls) or "none"
        message = (
            f"space.controls: expected {clock - 1} names, for the controls of the dynamics; received {names}"
        )
        raise UserError(message)
