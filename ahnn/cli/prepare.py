"""Preparation of a training run without generating data, so that errors appear early."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from lightning import Callback, Trainer, seed_everything
from lightning.pytorch.loggers import Logger
from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import flatten
from ahnn.checkpoints import FORMAT
from ahnn.cli.build import factories, factory, plain_config, stored, without_network
from ahnn.cli.parts import (
    SENSOR,
    SIMULATION,
    build_plugins,
    build_sensor,
    build_source,
    is_multirun,
    is_one_of_several,
    report_options,
)
from ahnn.cli.unused_keys import asked_for, require_read
from ahnn.data import Source
from ahnn.data.datamodule import WindowDataModule
from ahnn.errors import UserError
from ahnn.jobs.compatible import check_together
from ahnn.jobs.prepared import Prepared
from ahnn.models import AbstractModel, Optimisation
from ahnn.stored import about_space
from ahnn.training.checkpoint_io import AtomicCheckpointIO

Factories = dict[str, Callable[..., Any]]

DECISIVE = ("max_epochs", "gradient_clip_val", "gradient_clip_algorithm", "accumulate_grad_batches")
"""Trainer settings that affect the weights."""
CHOOSING = ("callbacks.best.monitor", "callbacks.rollout.count", "callbacks.rollout.every")
"""Settings that select the best weights."""
SMOKE = "budget=smoke only checks the installation; the default budget trains the model"
"""Finding below the table of a run with budget=smoke, unless more epochs are requested."""
FEW = 5
"""Number of epochs of budget=smoke."""


def prepare(cfg: DictConfig, source: Source | None = None, asked: Sequence[str] | None = None) -> Prepared:
    """Build all parts of a training run, and check their compatibility.

    Args:
        cfg: configuration of one job.
        source: source of the trajectories; None: the system of the configuration.
        asked: overrides of the configuration; None: the overrides on the command line.

    Raises:
        UserError: incompatible parts, an override without effect, or members, which are trained together.
    """
    if cfg.get("members"):
        message = (
            f"members: expected null, since one model is trained here; received {cfg.members}. Use "
            "python -m ahnn.train"
        )
        raise UserError(message)
    cfg = without_network(cfg)
    torch.set_num_threads(cfg.threads)
    seed_everything(cfg.seed, verbose=False)
    values, made = plain_config(cfg), factories_of(cfg)
    source, folder = source or build_source(cfg), Path(cfg.folder)
    data = made["data"](source=source, window=cfg.window, sensor=build_sensor(cfg, source))
    plugins = build_plugins(cfg.plugins, data.splits)
    model = build_model(values, made, data)
    trainer = build_trainer(made, folder)
    data.feed(trainer)
    caveat = SMOKE if "budget=smoke" in asked_for(asked) and cfg.trainer.max_epochs <= FEW else ""
    prepared = Prepared(
        label=cfg.label,
        seed=cfg.seed,
        folder=folder,
        config=stored(cfg),
        data=data,
        model=model,
        trainer=trainer,
        checkpoint=checkpoint_of(cfg.ckpt, cfg.folder),
        weights=cfg.weights,
        recorded=cfg.cuda_graphs,
        robust=cfg.loss.get("robust", "none"),
        plugins=plugins,
        evaluation_seed=cfg.evaluation.seed,
        report=report_options(cfg.evaluation),
        searched=searched(values),
        caveat=caveat,
    )
    check_together(prepared)
    require_read(cfg, prepared, asked)
    return prepared


def checkpoint_of(asked: str | None, folder: str) -> Path | None:
    """Return the checkpoint to resume from: `last` or `best` of a run folder, a file, or None.

    A training that is one of several begins where it has no checkpoint yet.
    """
    if asked not in ("last", "best"):
        return None if asked is None else Path(asked)
    found = Path(folder, "checkpoints", f"{asked}.ckpt")
    return found if found.exists() or not is_one_of_several(folder) else None


def factories_of(cfg: DictConfig) -> Factories:
    """Return the factories of the parts of a training run.

    Raises:
        UserError: a GPU is requested, and there is none.
    """
    data = {key: value for key, value in plain_config(cfg.data).items() if key not in (*SIMULATION, *SENSOR)}
    node = cfg.trainer.copy()
    if cfg.loss.get("stages") and node.accelerator == "auto":
        node.accelerator = "cpu"  # small batches and many small operations: a gain on a GPU is not measured
    if node.accelerator in ("gpu", "cuda") and not torch.accelerator.is_available():
        message = "trainer.accelerator: expected a GPU; received none. Use trainer.accelerator=cpu or auto"
        raise UserError(message)
    for_data, for_model = ("source", "window", "sensor"), ("dof", "inertia", "window", "controls", "angular")
    for_trainer = ("plugins", "callbacks", "logger", "default_root_dir")
    return {
        "data": factory(OmegaConf.create(data), "data", WindowDataModule, for_data),
        "model": factory(cfg.model, "model", AbstractModel, for_model),
        "optimizer": factory(cfg.optimizer, "optimizer"),
        **({"scheduler": factory(cfg.scheduler, "scheduler")} if cfg.scheduler else {}),
        "trainer": factory(node, "trainer", Trainer, for_trainer),
        **factories(cfg.callbacks, "callbacks", Callback),
        **factories(cfg.logger, "logger", Logger),
    }


def build_model(values: dict[str, Any], made: Factories, data: WindowDataModule) -> AbstractModel:
    """Build the model, with its optimiser and the metadata of its checkpoints."""
    space, source, scheduler = data.source.space, data.source, made.get("scheduler")
    given = {"dof": space.dof, "inertia": about_space(space)["inertia"], "controls": len(space.controls)}
    given |= {"angular": space.angular}
    model = made["model"](**given, window=data.window).to(data.dtype)
    known = {"recipe": source.recipe(), "split": list(data.splits.fractions)}
    about = {"format": FORMAT, "space": about_space(space), "data": known, "settings": settings_of(values)}
    model.train_by(Optimisation(made["optimizer"](), scheduler and scheduler()), about)
    return model


def build_trainer(made: Factories, folder: Path) -> Trainer:
    """Build the Lightning trainer with its callbacks and loggers.

    Raises:
        UserError: several devices inside the process of a sweep, whose first job would not release them.
    """
    callbacks, loggers = (
        [build_it() for name, build_it in made.items() if name.startswith(group)]
        for group in ("callbacks.", "logger.")
    )
    parts = {"callbacks": callbacks, "logger": loggers, "default_root_dir": str(folder)}
    trainer = made["trainer"](plugins=[AtomicCheckpointIO()], **parts)
    environment = getattr(trainer.strategy, "cluster_environment", None)
    own = environment is not None and environment.creates_processes_externally
    if trainer.world_size > 1 and is_multirun() and not own:
        message = (
            "trainer: expected one device, or a separate process for each sweep job; received "
            f"{trainer.world_size} devices inside the sweep process. Add hydra/launcher=ahnn_process"
        )
        raise UserError(message)
    return trainer


def settings_of(values: dict[str, Any]) -> dict[str, Any]:
    """Return the settings that determine the training besides its data; a resumed run must share them."""
    parts = {name: values[name] for name in ("model", "loss", "optimizer", "scheduler", "data")}
    parts["data"] = {key: value for key, value in parts["data"].items() if key not in SIMULATION}
    flat = flatten(values)
    parts |= {key: flat.get(key) for key in (*CHOOSING, "window", "seed")}
    return {**parts, "trainer": {key: values["trainer"].get(key) for key in DECISIVE}}


def searched(values: dict[str, Any]) -> dict[str, Any]:
    """Return the keys varied by a search, for TensorBoard's comparison of runs."""
    groups = {name: values[name] for name in ("model", "optimizer", "scheduler") if values[name]}
    amounts = {"window": values["window"], "batch_size": values["data"]["batch_size"]}
    amounts |= {f"data.{key}": values["data"].get(key) for key in ("noise", "trajectories")}
    amounts |= {"forces": ", ".join(values["model"].get("forces") or ()) or None}
    amounts = {key: value for key, value in amounts.items() if value is not None}
    return {**groups, **amounts, "epochs": values["trainer"]["max_epochs"], "seed": values["seed"]}
