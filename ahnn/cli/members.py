"""Trainings of an ensemble at once, from a configuration with `members`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import cast

from omegaconf import DictConfig

from ahnn.cli.build import Part, factories, factory, stored
from ahnn.cli.early_stops import held, interruptible
from ahnn.cli.parts import is_multirun
from ahnn.cli.preflight import require_new
from ahnn.files import claimed, require_writable
from ahnn.jobs.fitting_members import PreparedEnsemble


def train_members(cfg: DictConfig) -> float:
    """Train all members at once, evaluate each, and return the mean of the best validation losses."""
    with held():
        prepared = prepare_members(cfg)
    for folder in (prepared.folder, *(member.folder for member in prepared.members)):
        require_new(folder, cfg.ckpt)
    prepared.members[0].data.train_dataloader()  # last check: files are written from here on
    require_writable(prepared.folder)
    from ahnn.jobs.closing import require_converged
    from ahnn.jobs.fitting_members import fit_ensemble, judge_members

    again = f"resume with the same command and run={cfg.folder} ckpt=last"
    with claimed(prepared.folder):
        with interruptible(prepared.trainer, lambda: again):
            seconds = fit_ensemble(prepared)
            loss = judge_members(prepared, seconds)
    if not is_multirun():
        require_converged([member.folder for member in prepared.members])
    return loss


def prepare_members(cfg: DictConfig) -> PreparedEnsemble:
    """Build the trainings of all members and the trainer that they share.

    Raises:
        UserError: incompatible parts, or settings that couple the members.
    """
    from ahnn.cli.prepare import build_trainer, parts_of, prepare
    from ahnn.cli.training import of_seed
    from ahnn.models import EnsembleModel
    from ahnn.training.callbacks import MemberPoints, ValidationRollout
    from ahnn.training.restore import require_resumable

    alone = cfg.copy()
    alone.members, alone.ckpt = None, None
    members = [prepare(of_seed(alone, seed)) for seed in range(cfg.seed, cfg.seed + cfg.members)]
    data = members[0].data
    data.group([member.data.orders[0] for member in members])
    members = [replace(member, data=data) for member in members]
    model, folder = EnsembleModel([member.model for member in members]), Path(cfg.folder)
    shared = cfg.copy()
    shared.callbacks.best = shared.callbacks.rollout = None
    trainer = build_trainer(factories(parts_of(shared)), folder)
    rollouts = [factory("callbacks.rollout", Part(cfg.callbacks.rollout, ValidationRollout))() for _ in members]
    points = MemberPoints([m.folder for m in members], cfg.callbacks.best.monitor, cast("list[ValidationRollout]", rollouts))
    trainer.callbacks.append(points)  # pyright: ignore[reportAttributeAccessIssue]
    data.feed(trainer)
    model.check(trainer)
    checkpoint = None if cfg.ckpt is None else Path(cfg.ckpt)
    if cfg.ckpt == "last":
        checkpoint = folder / "checkpoints" / "last.ckpt"
    if checkpoint is not None:
        require_resumable(checkpoint, model, trainer)
    return PreparedEnsemble(
        folder=folder, config=stored(cfg), members=members, model=model, trainer=trainer, checkpoint=checkpoint
    )
