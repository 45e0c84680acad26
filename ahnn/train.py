"""Train a model and evaluate it: `python -m ahnn.train model=ahnn window=5 system=molniya`.

Reads from top to bottom: parts, fit, evaluation. The entry points and `config` alone see Hydra; what they
build takes plain values. Heavy imports wait until a job runs, so that `--help` and a sweep's parent are fast.
"""

from __future__ import annotations

import logging
import math
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import check_arguments
from ahnn.config import build, build_all, plain_config, run_hydra
from ahnn.errors import UserError

if TYPE_CHECKING:
    from lightning import Trainer

    from ahnn.data import WindowDataModule
    from ahnn.evaluation import EvaluationPlugin
    from ahnn.models import AbstractDynamics
    from ahnn.systems import System

log = logging.getLogger(__name__)


def train(cfg: DictConfig) -> float:
    """Train with one seed or with several; return the mean of the best validation losses.

    Several `seeds` train in folders of their own, seed_7 and so on, inside the run folder.
    """
    if not cfg.seeds:
        return train_once(cfg)
    losses = []
    for seed in cfg.seeds:
        part = cfg.copy()
        part.seed, part.seeds, part.folder = seed, None, f"{cfg.folder}/seed_{seed}"
        losses.append(train_once(part))
    return sum(losses) / len(losses)


def train_once(cfg: DictConfig) -> float:
    """Run one training and its evaluation; return the best validation loss, the objective of a search.

    Of several devices the first evaluates and writes; the other processes return NaN, which nobody reads.
    """
    import torch
    from lightning import seed_everything

    from ahnn.data.store import require_writable, write_atomically
    from ahnn.evaluation.report import finish
    from ahnn.setup import announce, check_devices, quiet, resume_point

    quiet()
    check_settings(cfg)
    folder = Path(cfg.folder)
    torch.set_num_threads(cfg.threads)
    seed_everything(cfg.seed, verbose=False)
    data, model = build_parts(cfg)
    plugins = build_plugins(cfg, data.system)
    checkpoint = resume_point(cfg.ckpt, model, folder / "checkpoints")
    require_writable(folder)
    trainer = build_trainer(cfg)
    check_devices(trainer, model, multirun=HydraConfig.get().mode is RunMode.MULTIRUN)

    model.calibrate(data.statistics())
    if trainer.is_global_zero:
        write_atomically(folder / "config.yaml", OmegaConf.to_yaml(plain_config(cfg)).encode())
        announce(trainer, data, model, cfg.label)
    started = time.monotonic()
    trainer.fit(model, data, ckpt_path=checkpoint)
    if not trainer.is_global_zero:
        return math.nan
    about = {
        "seed": cfg.seed,
        "training_seconds": round(time.monotonic() - started, 1),
        "optimiser_steps": trainer.global_step,
        "parameters": sum(p.numel() for p in model.parameters()),
    }
    known = {"loggers": trainer.loggers, "settings": searched_settings(cfg)}
    return finish(model, data, plugins, about, label=cfg.label, folder=folder, **known, **cfg.evaluation)


def searched_settings(cfg: DictConfig) -> dict[str, Any]:
    """Return the settings beside the model's that a search varies, for TensorBoard's comparison of runs."""
    groups = {name: plain_config(cfg[name]) for name in ("optimizer", "scheduler") if cfg[name]}
    return {**groups, "batch_size": cfg.data.batch_size, "epochs": cfg.trainer.max_epochs, "seed": cfg.seed}


def check_settings(cfg: DictConfig) -> None:
    """Check the keys that belong to no group.

    Raises:
        UserError: a wrong type or an impossible value.
    """

    def settings(*, seed: int, threads: int, window: int, label: str, ckpt: str | None) -> None: ...

    names = ("seed", "threads", "window", "label", "ckpt")
    check_arguments("configuration", settings, {name: cfg[name] for name in names})
    if cfg.threads < 1 or cfg.seed < 0:
        message = f"configuration: expected threads >= 1 and seed >= 0; received {cfg.threads} and {cfg.seed}"
        raise UserError(message)


def build_parts(cfg: DictConfig) -> tuple[WindowDataModule, AbstractDynamics]:
    """Build system, DataModule and model; nothing is generated yet, so that mistakes show at once."""
    from ahnn.models import Optimisation

    system = build(cfg.system, "system")
    data = build(cfg.data, "data", system=system)
    model = build(cfg.model, "model", dof=system.dof, inertia=system.inertia).to(data.dtype)
    scheduler = build(cfg.scheduler, "scheduler") if cfg.scheduler else None
    model.optimisation = Optimisation(build(cfg.optimizer, "optimizer"), scheduler)
    model.configure_optimizers()
    model.provenance = {"system": plain_config(cfg.system)}
    return data, model


def build_plugins(cfg: DictConfig, system: System) -> dict[str, EvaluationPlugin]:
    """Build the evaluations that run after fit, and let each refuse a system that it does not fit."""
    plugins = build_all(cfg.plugins, "plugins")
    for plugin in plugins.values():
        plugin.check(system)
    return plugins


def build_trainer(cfg: DictConfig) -> Trainer:
    """Build the Lightning trainer with its callbacks and loggers.

    Raises:
        UserError: the machine lacks what is asked for, such as a second GPU.
    """
    from lightning.fabric.utilities.exceptions import MisconfigurationException

    parts = {
        "callbacks": list(build_all(cfg.callbacks, "callbacks").values()),
        "logger": list(build_all(cfg.logger, "logger").values()),
    }
    try:
        return build(cfg.trainer, "trainer", **parts, default_root_dir=cfg.folder)
    except MisconfigurationException as error:
        message = f"trainer: {error}"
        raise UserError(message) from error


def main() -> None:
    """Entry point of `python -m ahnn.train` and `ahnn-train`."""
    os.environ.setdefault("TORCH_CPP_LOG_LEVEL", "ERROR")  # DDP warns of what is meant so
    run_hydra(train)


if __name__ == "__main__":
    main()
