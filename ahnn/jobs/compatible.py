"""Compatibility checks of data, model and trainer, before data generation."""

from __future__ import annotations

import logging
from typing import Any

from ahnn.data.datamodule import WindowDataModule
from ahnn.data.files.recordings import Recordings
from ahnn.dynamics.mass_matrix import MassMatrixHamiltonian
from ahnn.errors import UserError
from ahnn.jobs.prepared import Prepared
from ahnn.memory import require_memory
from ahnn.models import AbstractModel
from ahnn.training.identifiability import require_identifiable, require_unbiased
from ahnn.training.normal_equations import memory_of, memory_of_parts
from ahnn.training.objectives import PARTS
from ahnn.training.restore import require_resumable

log = logging.getLogger(__name__)


def check_together(prepared: Prepared) -> None:
    """Check that data, model, trainer and checkpoint are compatible; call `check` of model and callbacks.

    Raises:
        UserError: an incompatibility; the message names the key.
    """
    data, model, trainer = prepared.data, prepared.model, prepared.trainer
    require_learnable(model, data)
    require_momenta(model, data)
    if data.sensor is not None and data.sensor.unknown.correlation and prepared.robust != "none":
        message = (
            f"data.correlation: expected loss.robust=none; received loss.robust={prepared.robust}. Leave one "
            "of them out"
        )
        raise UserError(message)
    if data.source.space.controls and model.dynamics.clock < 2:
        what = "the controls %s in the data have no effect in this model; forces=controls uses them"
        log.warning(what, ", ".join(data.source.space.controls))
    if model.curriculum.span is not None:
        data.require_span(model.curriculum.span, model.dynamics.clock)
    else:
        data.follow(model.curriculum, int(trainer.max_epochs or 1))
    parts: list[Any] = [model, *trainer.callbacks]  # pyright: ignore[reportAttributeAccessIssue]
    for part in parts:
        if check := getattr(part, "check", None):
            check(trainer)
    if not model.stepper.automatic:
        require_equations(model, data)
    if prepared.checkpoint is not None:
        require_resumable(prepared.checkpoint, model, trainer)


def require_learnable(model: AbstractModel, data: WindowDataModule) -> None:
    """Reject dynamics that the data do not determine, or whose integrator does not support the true field.

    Raises:
        UserError: such dynamics; the message names the key.
    """
    if (method := getattr(model.dynamics, "integrator", None)) and data.source.truth is not None:
        method.require(data.source.truth)  # the floor uses the model's integrator
    if data.sensor is not None:
        require_identifiable(model.dynamics, data.sensor, windows=model.curriculum.span is not None)
        require_unbiased(model.about["settings"]["loss"].get("balance", 0.0))


def require_momenta(model: AbstractModel, data: WindowDataModule) -> None:
    """Raise UserError for a learned mass matrix M(q) with velocities from files, since p = M(q) v."""
    source = data.source
    stated = isinstance(source, Recordings) and not source.positions_only and not source.momenta
    if stated and any(isinstance(part, MassMatrixHamiltonian) for part in model.dynamics.modules()):
        message = (
            "hamiltonian=mass_matrix: expected momenta p = M(q) v in the files, with system.mass=canonical; "
            "received velocities. Use model=lnn, which learns from velocities"
        )
        raise UserError(message)


def require_equations(model: AbstractModel, data: WindowDataModule) -> None:
    """Raise UserError for second-order steps whose normal equations do not fit into memory."""
    count = sum(p.numel() for p in model.dynamics.parameters())
    if data.stages is None:
        windows = min(data.batch_size, data.windows_per_epoch or data.batch_size)
        size = memory_of(count, 2 * model.dof * max(1, windows // PARTS))
    else:
        size = memory_of_parts(count)
    who = "model.network" if size < 2 * memory_of(count, 0) or data.stages else "data.batch_size"
    remedy = "Choose a smaller network or batch" + ("" if data.stages else ", or recipe=first_order")
    require_memory(who, f"the equations for second-order steps on {count:,} parameters", size, remedy)
