"""From a configuration to a prepared training, in one place; nothing is generated: mistakes show at once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from lightning import Callback, Trainer, seed_everything
from lightning.pytorch.loggers import Logger
from omegaconf import DictConfig, OmegaConf

from ahnn.checkpoints import FORMAT
from ahnn.cli.build import build, build_all, plain_config, stored
from ahnn.cli.parts import (
    SENSOR,
    SIMULATION,
    build_plugins,
    build_sensor,
    build_source,
    is_multirun,
    report_options,
)
from ahnn.cli.unread import require_read
from ahnn.data import Source
from ahnn.data.datamodule import WindowDataModule
from ahnn.errors import UserError
from ahnn.jobs.checks import check_learnable, check_together
from ahnn.jobs.prepared import Assessment, Prepared
from ahnn.models import AbstractModel, Optimisation
from ahnn.stored import about_space
from ahnn.training.checkpoint_io import AtomicCheckpointIO
from ahnn.training.restore import resume_point


def prepare(cfg: DictConfig, source: Source | None = None, asked: Sequence[str] | None = None) -> Prepared:
    """Build all that a training needs, and let the parts refuse each other.

    Args:
        cfg: one job.
        source: of the trajectories; None takes the system of the configuration.
        asked: overrides behind it; None takes those of the command line.

    Raises:
        UserError: parts that do not go together, or an override that none of them reads.
    """
    torch.set_num_threads(cfg.threads)
    seed_everything(cfg.seed, verbose=False)
    data = build_data(cfg, source or build_source(cfg))
    model = build_model(cfg, data)
    plugins = build_plugins(cfg, data.splits)
    trainer = build_trainer(cfg)
    check_together(trainer, model, data)
    data.feed(trainer)
    prepared = Prepared(
        label=cfg.label,
        seed=cfg.seed,
        folder=Path(cfg.folder),
        config=stored(cfg),
        data=data,
        model=model,
        trainer=trainer,
        checkpoint=resume_point(cfg.ckpt, model, trainer, Path(cfg.folder) / "checkpoints"),
        weights=cfg.weights,
        recorded=cfg.cuda_graphs,
        robust=cfg.loss.get("robust", "none"),
        assessment=Assessment(plugins, cfg.evaluation.seed, report_options(cfg), searched_settings(cfg)),
    )
    require_read(cfg, prepared, asked)
    return prepared


def build_data(cfg: DictConfig, source: Source) -> WindowDataModule:
    """Build the DataModule of a training."""
    left_out = (*SIMULATION, *SENSOR)
    options = {key: value for key, value in plain_config(cfg.data).items() if key not in left_out}
    sensor = build_sensor(cfg, source)
    return build(OmegaConf.create(options), "data", source=source, window=cfg.window, sensor=sensor)


def build_model(cfg: DictConfig, data: WindowDataModule) -> AbstractModel:
    """Build the model, with the factories of its optimiser, and what checkpoints say of it."""
    space = data.source.space
    given = {"dof": space.dof, "inertia": space.inertia, "window": cfg.window}
    model = build(cfg.model, "model", **given).to(data.dtype)
    check_learnable(model, data, cfg.loss.get("balance", 0.0))
    if model.curriculum.span is not None:
        data.require_span(model.curriculum.span)
    else:
        data.follow(model.curriculum, cfg.trainer.max_epochs)
    scheduler = build(cfg.scheduler, "scheduler") if cfg.scheduler else None
    known = {"recipe": data.source.recipe(), "split": list(data.splits.fractions)}
    about = {"format": FORMAT, "space": about_space(space), "data": known, "settings": settings_of(cfg)}
    model.train_by(Optimisation(build(cfg.optimizer, "optimizer"), scheduler), about)
    return model


DECISIVE = ("max_epochs", "gradient_clip_val", "gradient_clip_algorithm", "accumulate_grad_batches")
"""What of the trainer changes the weights."""
CHOOSING = ("callbacks.best.monitor", "callbacks.rollout.count", "callbacks.rollout.every")
"""What chooses the best of them."""


def settings_of(cfg: DictConfig) -> dict[str, Any]:
    """Return all that determines a training besides its data: what a resumed one must share."""
    parts = {name: plain_config(cfg[name]) for name in ("model", "loss", "optimizer", "scheduler", "data")}
    parts["data"] = {key: value for key, value in parts["data"].items() if key not in SIMULATION}
    parts |= {key: OmegaConf.select(cfg, key) for key in (*CHOOSING, "window", "seed")}
    return {**parts, "trainer": {key: cfg.trainer.get(key) for key in DECISIVE}}


def build_trainer(cfg: DictConfig) -> Trainer:
    """Build the Lightning trainer with its callbacks and loggers.

    Raises:
        UserError: several devices inside the process of a sweep, which the first job would not give back.
    """
    callbacks = list(build_all(cfg.callbacks, "callbacks", Callback).values())
    logger = list(build_all(cfg.logger, "logger", Logger).values())
    parts = {"callbacks": callbacks, "logger": logger, "default_root_dir": cfg.folder}
    own = cfg.trainer.copy()
    if cfg.loss.get("stages") and own.accelerator == "auto":
        own.accelerator = "cpu"  # where measurements are learned from
    trainer = build(own, "trainer", Trainer, plugins=[AtomicCheckpointIO()], **parts)
    environment = getattr(trainer.strategy, "cluster_environment", None)
    own = environment is not None and environment.creates_processes_externally
    if trainer.world_size > 1 and is_multirun() and not own:
        message = (
            "trainer: expected one device, or a process for each job of the sweep; received "
            f"{trainer.world_size} devices inside the process of the sweep. Add hydra/launcher=ahnn_process"
        )
        raise UserError(message)
    return trainer


def searched_settings(cfg: DictConfig) -> dict[str, Any]:
    """Return what a search varies, for TensorBoard's comparison of runs."""
    groups = {name: plain_config(cfg[name]) for name in ("model", "optimizer", "scheduler") if cfg[name]}
    amounts = {"window": cfg.window, "batch_size": cfg.data.batch_size, "epochs": cfg.trainer.max_epochs}
    return {**groups, **amounts, "seed": cfg.seed}
