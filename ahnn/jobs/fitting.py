"""Fit of a prepared training run: calibration, announcements, and Lightning's loop."""

from __future__ import annotations

import logging
import math

from ahnn.checkpoints import read_checkpoint, require_same
from ahnn.files import write_atomically
from ahnn.jobs.evaluation_estimate import evaluation_seconds
from ahnn.jobs.prepared import Prepared
from ahnn.loading import load
from ahnn.models import AbstractModel
from ahnn.progress import about, stage
from ahnn.training.callbacks.training_time import timed_fit
from ahnn.training.closing_estimate import shooting_cost
from ahnn.training.cuda_graph import RecordedStep, can_record
from ahnn.training.runtime_estimate import expected_seconds
from ahnn.uncertainty import find_domain

log = logging.getLogger("ahnn")


def fit(prepared: Prepared) -> float:
    """Train and return the duration of all steps in seconds, including those before a resumption."""
    trainer = prepared.trainer
    calibrate(prepared)
    if prepared.model.dynamics.begins_known and prepared.checkpoint is None:
        trainer.num_sanity_val_steps = math.inf  # the known physics alone may remain the best model
    if trainer.is_global_zero:
        announce(prepared)
        # Keys without any effect have already been rejected.
        for run in (prepared, *prepared.members):
            write_atomically(run.folder / "config.yaml", run.config)
    return timed_fit(trainer, prepared.model, prepared.data, ckpt_path=prepared.checkpoint)


def calibrate(prepared: Prepared) -> None:
    """Fit a model's scalings to the training split, and record the metadata of the data."""
    data, model, trainer = prepared.data, prepared.model, prepared.trainer
    statistics = data.statistics()
    model.calibrate(statistics)
    if prepared.weights is not None and prepared.checkpoint is None:
        begin_at(model, prepared.weights)
    model.to(trainer.strategy.root_device)
    # The integrator may take shorter steps between measurements; the dynamics are learned for these.
    dt = min(statistics.dt, math.inf if data.sensor is None else data.instrument.longest)
    domain = find_domain(model.dynamics.frozen().cpu(), data.examples()).about()
    model.learns_from(dt=dt, domain=domain, seen=data.splits.seen())
    if prepared.recorded and can_record(trainer, model):
        model.step_by(RecordedStep(len(data.train_dataloader().batches()[0])))


def begin_at(model: AbstractModel, run: str) -> None:
    """Initialise a model with the weights of a run or shipped model, for a new training schedule.

    Raises:
        UserError: the weights belong to other dynamics.
    """
    trained = load(run).trained
    require_same(f"weights {run}", {"dynamics": model.dynamics.spec}, {"dynamics": trained.spec})
    model.dynamics.load_state_dict(trained.state_dict())


def announce(prepared: Prepared) -> None:
    """Log remarks on the data, the remaining optimiser steps, and the runtime estimate."""
    data, model, trainer = prepared.data, prepared.model, prepared.trainer
    if remark := data.remark():
        log.warning(remark)
    if prepared.members:
        return announce_members(prepared)
    done = 0 if prepared.checkpoint is None else read_checkpoint(prepared.checkpoint)["global_step"]
    per_epoch = -(-len(data.train_dataloader()) // trainer.accumulate_grad_batches)
    epochs = range(done // per_epoch, int(trainer.max_epochs or 1))
    with stage("timing some steps"):
        shooting = None if data.stages is None else shooting_cost(model, data)
        seconds = expected_seconds(trainer, data, model, per_epoch, epochs, shooting)
        seconds += evaluation_seconds(prepared, shooting)
    log.info(
        "training %s on %s: %s optimiser steps of %d windows in %d epochs%s, %s with evaluation",
        prepared.label,
        data.source.space.name,
        f"{per_epoch * epochs.stop - done:,}",
        data.batch_size,
        len(epochs),
        f" and at most {last} closing steps on all data" if (last := model.curriculum.closing) else "",
        about(seconds),
    )


def announce_members(prepared: Prepared) -> None:
    """Log the number of members and steps."""
    data, epochs = prepared.data, int(prepared.trainer.max_epochs or 1)
    log.info(
        "training %d members of %s on %s together: %s steps of %d windows each in %d epochs",
        len(prepared.members),
        prepared.label,
        data.source.space.name,
        f"{len(data.train_dataloader()) * epochs:,}",
        data.batch_size,
        epochs,
    )
