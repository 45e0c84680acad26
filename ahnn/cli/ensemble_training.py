"""Joint training of the members of an ensemble, from a configuration with `members`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig

from ahnn.cli.build import factory, stored, without_network
from ahnn.cli.early_stops import held, interruptible
from ahnn.cli.parts import is_multirun
from ahnn.cli.preflight import require_new
from ahnn.cli.training import go_on, of_seed
from ahnn.errors import UserError
from ahnn.files import claimed, require_writable

if TYPE_CHECKING:
    from ahnn.jobs.prepared import Prepared
    from ahnn.training.callbacks import MemberPoints


def train_members(cfg: DictConfig) -> float:
    """Train all members together, evaluate each, and return the mean of the best validation losses."""
    with held():
        prepared = prepare_members(cfg)
    for folder in (prepared.folder, *(member.folder for member in prepared.members)):
        require_new(folder, cfg.ckpt)
    prepared.data.train_dataloader()  # last check: files are written from here on
    require_writable(prepared.folder)
    from ahnn.jobs.closing import judge_members, require_converged
    from ahnn.jobs.fitting import fit

    with claimed(prepared.folder), interruptible(prepared.trainer, lambda: go_on(cfg)):
        loss = judge_members(prepared, fit(prepared))
    if not is_multirun():
        require_converged([member.folder for member in prepared.members])
    return loss


def prepare_members(cfg: DictConfig) -> Prepared:
    """Build the training runs of all members, and their joint training run.

    Raises:
        UserError: incompatible parts, or settings that couple the members.
    """
    from ahnn.cli.prepare import build_trainer, checkpoint_of, factories_of, prepare
    from ahnn.models import EnsembleModel
    from ahnn.training.restore import require_resumable

    cfg = without_network(cfg)
    alone = cfg.copy()
    alone.members, alone.ckpt = None, None
    members = [prepare(of_seed(alone, seed)) for seed in range(cfg.seed, cfg.seed + cfg.members)]
    data = members[0].data
    data.group([member.data.orders[0] for member in members])
    members = [replace(member, data=data) for member in members]
    shared = cfg.copy()
    shared.callbacks.best = shared.callbacks.rollout = None
    folder = Path(cfg.folder)
    trainer = build_trainer(factories_of(shared), folder)
    trainer.callbacks.append(points_of(cfg.callbacks, members))  # pyright: ignore[reportAttributeAccessIssue]
    data.feed(trainer)
    model = EnsembleModel([member.model for member in members])
    model.check(trainer)
    if (checkpoint := checkpoint_of(cfg.ckpt, cfg.folder)) is not None:
        require_resumable(checkpoint, model, trainer)
    joint = {"folder": folder, "config": stored(cfg), "checkpoint": checkpoint, "members": members}
    return replace(members[0], **joint, model=model, trainer=trainer, recorded=False)


def points_of(callbacks: DictConfig, members: Sequence[Prepared]) -> MemberPoints:
    """Return the callback that keeps each member's best weights; raises UserError if nothing selects them."""
    from ahnn.training.callbacks import MemberPoints, ValidationRollout

    best, node = callbacks.get("best"), callbacks.get("rollout")
    if best is None or node is None:
        message = (
            "callbacks: expected best and rollout, which select the weights of each member; received "
            f"callbacks.{'best' if best is None else 'rollout'}=null"
        )
        raise UserError(message)
    made = factory(node, "callbacks.rollout", ValidationRollout)
    return MemberPoints([member.folder for member in members], best.monitor, [made() for _ in members])
