"""Ensembles: fit of all members in one loop, and evaluation of each member in its own run folder."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from lightning import Trainer

from ahnn.files import write_atomically
from ahnn.jobs.closing import judge
from ahnn.jobs.fitting import calibrate
from ahnn.jobs.prepared import Prepared
from ahnn.models import EnsembleModel
from ahnn.training.callbacks.training_time import timed_fit

log = logging.getLogger("ahnn")


@dataclass(frozen=True, kw_only=True)
class PreparedEnsemble:
    """Joint training runs, before anything is generated or written.

    Attributes:
        folder: folder of the ensemble, which contains the folders of the members.
        config: content of the ensemble's config.yaml.
        members: training run of each member; all share the same data.
        model: the members as one model.
        trainer: trainer of all members.
        checkpoint: checkpoint of the ensemble to resume from; None for a new training.
    """

    folder: Path
    config: bytes
    members: Sequence[Prepared]
    model: EnsembleModel
    trainer: Trainer
    checkpoint: Path | None


def fit_ensemble(prepared: PreparedEnsemble) -> float:
    """Train all members and return the duration of all steps in seconds; see `ahnn.jobs.fitting.fit`."""
    trainer, first = prepared.trainer, prepared.members[0]
    calibrate_all(prepared)
    if first.model.dynamics.begins_known and prepared.checkpoint is None:
        trainer.num_sanity_val_steps = math.inf
    announce(prepared)
    write_atomically(prepared.folder / "config.yaml", prepared.config)
    for member in prepared.members:
        member.folder.mkdir(exist_ok=True)
        write_atomically(member.folder / "config.yaml", member.config)
    return timed_fit(trainer, prepared.model, first.data, ckpt_path=prepared.checkpoint)


def calibrate_all(prepared: PreparedEnsemble) -> None:
    """Fit the scalings of all members to the training split, and record the metadata of the data."""
    first, *others = prepared.members
    calibrate(replace(first, trainer=prepared.trainer, recorded=False, checkpoint=prepared.checkpoint))
    statistics, known = first.data.statistics(), first.model.about
    for member in others:
        member.model.calibrate(statistics)
        member.model.to(prepared.trainer.strategy.root_device)
        member.model.learns_from(**{key: known[key] for key in ("dt", "domain", "seen")})


def announce(prepared: PreparedEnsemble) -> None:
    """Log remarks on the data, and the number of members and steps."""
    first, trainer = prepared.members[0], prepared.trainer
    if remark := first.data.remark():
        log.warning(remark)
    steps = len(first.data.train_dataloader()) * int(trainer.max_epochs or 1)
    what = "training %d members of %s on %s together: %s steps of %d windows each in %d epochs"
    space, size = first.data.source.space.name, first.data.batch_size
    log.info(
        what, len(prepared.members), first.label, space, f"{steps:,}", size, int(trainer.max_epochs or 1)
    )


def judge_members(prepared: PreparedEnsemble, seconds: float) -> float:
    """Evaluate the best weights of each member, and return the mean of the validation losses.

    Args:
        prepared: prepared ensemble.
        seconds: duration of the steps of all members.
    """
    each, steps = seconds / len(prepared.members), prepared.trainer.global_step
    losses = [judge(member, each, steps) for member in prepared.members]
    return sum(losses) / len(losses)
