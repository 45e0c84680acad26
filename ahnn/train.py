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

from ahnn.cli.build import build, build_all, plain_config
from ahnn.cli.entry import run_hydra
from ahnn.cli.settings import check_settings

if TYPE_CHECKING:
    from lightning import Trainer

    from ahnn.data import WindowDataModule
    from ahnn.evaluation import EvaluationPlugin
    from ahnn.models import AbstractDynamics

log = logging.getLogger(__name__)


def train(cfg: DictConfig) -> float:
    """Train with one seed or with several; return the mean of the best validation losses.

    Several `seeds` train in folders of their own, seed_7 and so on, inside the run folder.
    """
    from ahnn.cli.setup import quiet, require_new

    quiet()
    check_settings(cfg)
    parts = [of_seed(cfg, seed) for seed in cfg.seeds] if cfg.seeds else [cfg]
    for part in parts:
        require_new(Path(part.folder), part.ckpt)
    return sum(train_once(part) for part in parts) / len(parts)


def of_seed(cfg: DictConfig, seed: int) -> DictConfig:
    """Return the configuration of one seed among several."""
    part = cfg.copy()
    part.seed, part.seeds, part.folder = seed, None, f"{cfg.folder}/seed_{seed}"
    return part


def train_once(cfg: DictConfig) -> float:
    """Run one training and its evaluation; return the best validation loss, the objective of a search.

    Of several devices the first evaluates and writes; the other processes return NaN, which nobody reads.
    """
    import torch
    from lightning import seed_everything

    from ahnn.cli.setup import announce, check_devices, check_steps, interruptible, resume_point
    from ahnn.data.store import require_writable, write_atomically
    from ahnn.evaluation.report import finish

    folder = Path(cfg.folder)
    torch.set_num_threads(cfg.threads)
    seed_everything(cfg.seed, verbose=False)
    data, model = build_parts(cfg)
    plugins = build_plugins(cfg, data)
    checkpoint = resume_point(cfg.ckpt, model, folder / "checkpoints")
    trainer = build_trainer(cfg)
    check_devices(trainer, model, multirun=HydraConfig.get().mode is RunMode.MULTIRUN)
    check_steps(trainer, model)
    data.train_dataloader()  # the last that may be refused: from here on files are written

    require_writable(folder)
    model.calibrate(data.statistics())
    if trainer.is_global_zero:
        write_atomically(folder / "config.yaml", OmegaConf.to_yaml(plain_config(cfg)).encode())
        announce(trainer, data, model, cfg.label)
    started = time.monotonic()
    with interruptible(trainer, lambda: go_on(cfg)):
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
    with interruptible(trainer, lambda: f"it is trained; python -m ahnn.evaluate run={folder} judges it"):
        return finish(model, data, plugins, about, label=cfg.label, folder=folder, **known, **cfg.evaluation)


def go_on(cfg: DictConfig) -> str:
    """Return how to go on with a training that was stopped."""
    if cfg.get("trial") is not None:
        return "the same command goes on with the search"
    if not (Path(cfg.folder) / "checkpoints" / "last.ckpt").exists():
        return "there is no checkpoint yet: the same command begins anew"
    one_of_several = cfg.folder != HydraConfig.get().runtime.output_dir
    seed = f" seed={cfg.seed} seeds=null" if one_of_several else ""
    command = "keys of this job" if HydraConfig.get().mode is RunMode.MULTIRUN else "command"
    return f"go on with the same {command} and run={cfg.folder}{seed} ckpt=last"


def searched_settings(cfg: DictConfig) -> dict[str, Any]:
    """Return the settings beside the model's that a search varies, for TensorBoard's comparison of runs."""
    groups = {name: plain_config(cfg[name]) for name in ("optimizer", "scheduler") if cfg[name]}
    return {**groups, "batch_size": cfg.data.batch_size, "epochs": cfg.trainer.max_epochs, "seed": cfg.seed}


def build_parts(cfg: DictConfig) -> tuple[WindowDataModule, AbstractDynamics]:
    """Build system, DataModule and model; nothing is generated yet, so that mistakes show at once."""
    from ahnn.cli.setup import check_optimisation, check_spans
    from ahnn.models import Optimisation

    system = build(cfg.system, "system")
    data = build(cfg.data, "data", system=system)
    model = build(cfg.model, "model", dof=system.dof, inertia=system.inertia).to(data.dtype)
    check_spans(cfg.window, data, model)
    scheduler = build(cfg.scheduler, "scheduler") if cfg.scheduler else None
    model.optimisation = Optimisation(build(cfg.optimizer, "optimizer"), scheduler)
    check_optimisation(model)
    model.provenance = {"system": plain_config(cfg.system)}
    return data, model


def build_plugins(cfg: DictConfig, data: WindowDataModule) -> dict[str, EvaluationPlugin]:
    """Build the evaluations that run after fit, and let each refuse a system that it does not fit."""
    plugins = build_all(cfg.plugins, "plugins")
    for plugin in plugins.values():
        plugin.check(data.system)
    return plugins


def build_trainer(cfg: DictConfig) -> Trainer:
    """Build the Lightning trainer with its callbacks and loggers."""
    from lightning import Callback, Trainer
    from lightning.pytorch.loggers import Logger

    callbacks = list(build_all(cfg.callbacks, "callbacks", Callback).values())
    logger = list(build_all(cfg.logger, "logger", Logger).values())
    parts = {"callbacks": callbacks, "logger": logger, "default_root_dir": cfg.folder}
    return build(cfg.trainer, "trainer", Trainer, **parts)


def main() -> None:
    """Entry point of `python -m ahnn.train` and `ahnn-train`."""
    os.environ.setdefault("TORCH_CPP_LOG_LEVEL", "ERROR")  # DDP warns of what is intended
    run_hydra(train)


if __name__ == "__main__":
    main()
