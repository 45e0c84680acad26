"""Train a model and evaluate it: `python -m ahnn.train model=ahnn window=5 system=molniya`.

Reads from top to bottom: parts, fit, evaluation. The entry points and `cli` alone see Hydra; what they build
takes plain values. Heavy imports wait until a job runs, so that `--help` and a sweep's parent are fast.
"""

from __future__ import annotations

if __name__ == "__main__":  # until `guard` listens, Ctrl-C ends this process without a traceback
    import signal

    signal.signal(signal.SIGINT, signal.SIG_DFL)

import logging
import math
import os
import time
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from ahnn.cli.build import plain_config
from ahnn.cli.entry import run_hydra

if TYPE_CHECKING:
    from lightning import Trainer

    from ahnn.data import Source
    from ahnn.data.datamodule import WindowDataModule
    from ahnn.evaluation import EvaluationPlugin
    from ahnn.models import AbstractModel

log = logging.getLogger("ahnn")  # `__name__` is `__main__` where this is run as a module


def train(cfg: DictConfig) -> float:
    """Train with one seed or with several; return the mean of the best validation losses.

    Several `seeds` train in folders of their own, seed_7 and so on, inside the run folder.
    """
    from ahnn.cli.before import begin, require_new

    begin(cfg)
    parts = [of_seed(cfg, seed) for seed in cfg.seeds] if cfg.seeds else [cfg]
    for part in parts:
        require_new(Path(part.folder), part.ckpt)
    losses = [train_once(part) for part in parts]
    from ahnn.cli.closing import require_converged  # heavy, as the trainings before it
    from ahnn.cli.parts import is_multirun

    if not is_multirun():  # there each job has its scores, and a search goes by the losses
        require_converged([Path(part.folder) for part in parts])
    return sum(losses) / len(losses)


def of_seed(cfg: DictConfig, seed: int) -> DictConfig:
    """Return the configuration of one seed among several."""
    part = cfg.copy()
    part.seed, part.seeds, part.folder = seed, None, f"{cfg.folder}/seed_{seed}"
    return part


def check(cfg: DictConfig) -> None:
    """Refuse what a training refuses before it generates data; a sweep asks once, before its first trial.

    Raises:
        UserError: a job that cannot work.
    """
    from ahnn.cli.before import begin
    from ahnn.cli.stops import held

    begin(cfg)
    with held():
        prepare(of_seed(cfg, cfg.seeds[0]) if cfg.seeds else cfg)


train.check = check  # pyright: ignore[reportFunctionMemberAccess] - all that reaches a sweeper is this function


class Parts(NamedTuple):
    """What a training is made of."""

    data: WindowDataModule
    model: AbstractModel
    plugins: dict[str, EvaluationPlugin]
    trainer: Trainer
    checkpoint: Path | None


def prepare(cfg: DictConfig, source: Source | None = None, asked: Sequence[str] | None = None) -> Parts:
    """Build the parts of a training and let them refuse each other; nothing is generated or written."""
    import torch
    from lightning import seed_everything

    from ahnn.cli.parts import (
        build_data,
        build_model,
        build_plugins,
        build_source,
        build_trainer,
        check_together,
    )
    from ahnn.cli.unread import require_read
    from ahnn.training.restore import resume_point

    torch.set_num_threads(cfg.threads)
    seed_everything(cfg.seed, verbose=False)
    data = build_data(cfg, source or build_source(cfg))
    model = build_model(cfg, data)
    plugins = build_plugins(cfg, data.splits)
    trainer = build_trainer(cfg)
    check_together(trainer, model, data)
    checkpoint = resume_point(cfg.ckpt, model, trainer, Path(cfg.folder) / "checkpoints")
    parts = Parts(data, model, plugins, trainer, checkpoint)
    require_read(cfg, parts, asked)
    return parts


def train_once(cfg: DictConfig, source: Source | None = None, asked: Sequence[str] | None = None) -> float:
    """Run one training and its evaluation; return the best validation loss, the objective of a search.

    Of several devices the first evaluates and writes; the other processes return NaN, which nobody reads.

    Args:
        cfg: one job.
        source: of the trajectories; None takes the system of the configuration.
        asked: overrides behind it; None takes those of the command line.
    """
    from ahnn.cli.before import require_new
    from ahnn.cli.closing import concluded
    from ahnn.cli.stops import held, interruptible
    from ahnn.files import claimed, require_writable

    folder = Path(cfg.folder)
    require_new(folder, cfg.ckpt)
    with held():
        data, model, plugins, trainer, checkpoint = prepare(cfg, source, asked)
    data.train_dataloader()  # the last that may be refused: from here on files are written

    require_writable(folder)
    with claimed(folder) if trainer.is_global_zero else nullcontext():
        seconds = fit(cfg, trainer, model, data, checkpoint)
        if not trainer.is_global_zero:
            return math.nan
        with interruptible(trainer, lambda: f"evaluate it with python -m ahnn.evaluate run={folder}"):
            if data.stages is not None:
                seconds += concluded(cfg, data)
            training = {
                "seed": cfg.seed,
                "seconds": round(seconds, 1),
                "window": cfg.window,
                "steps": trainer.global_step,
                "parameters": sum(p.numel() for p in model.parameters()),
            }
            return judge(cfg, data, plugins, training, trainer)


def fit(
    cfg: DictConfig, trainer: Trainer, model: AbstractModel, data: WindowDataModule, checkpoint: Path | None
) -> float:
    """Train and return the seconds that it took."""
    from ahnn.checkpoints import read_checkpoint
    from ahnn.cli.stops import interruptible
    from ahnn.dynamics.scaling import remark_on_scale
    from ahnn.files import write_atomically
    from ahnn.training.cuda_graph import Recorded, can_record
    from ahnn.uncertainty import find_domain

    folder = Path(cfg.folder)
    statistics = data.statistics()
    model.calibrate(statistics)
    # Between measurements the integrator may take shorter steps, and the dynamics are learned for these.
    model.about["dt"] = min(statistics.dt, math.inf if data.sensor is None else data.instrument.longest)
    if cfg.weights is not None and checkpoint is None:
        begin_at(model, cfg.weights)
    model.about["domain"] = find_domain(model.dynamics.frozen(), data.examples()).about()
    model.about["seen"] = data.splits.seen()
    data.trainer = trainer  # steps are tried, and their time told, where they will be taken
    model.to(trainer.strategy.root_device)
    if cfg.cuda_graphs and can_record(trainer, model):
        model.recorded = Recorded(len(data.train_dataloader().batches()[0]))
    if trainer.is_global_zero:
        done = 0 if checkpoint is None else read_checkpoint(checkpoint)["global_step"]
        known, names = model.about["settings"]["model"], data.source.space.components
        scaled = remark_on_scale(known.get("scaling"), statistics.minimum, statistics.maximum, names)
        for remark in filter(None, (data.remark(), scaled)):
            log.warning(remark)
        announce(cfg.label, trainer, data, model, done)
        write_atomically(folder / "config.yaml", stored(cfg))  # what cannot take a step has been refused
    started = time.monotonic()
    with interruptible(trainer, lambda: go_on(cfg)):
        trainer.fit(model, data, ckpt_path=checkpoint)
    return time.monotonic() - started


def announce(label: str, trainer: Trainer, data: WindowDataModule, model: AbstractModel, done: int) -> None:
    """Say how many optimiser steps are left after those that are done, and about how long they take."""
    from ahnn.training.outlook import expected_seconds

    per_epoch = -(-len(data.train_dataloader()) // trainer.accumulate_grad_batches)
    epochs = range(done // per_epoch, int(trainer.max_epochs or 1))
    seconds = expected_seconds(trainer, data, model, per_epoch, epochs)
    log.info(
        "training %s on %s: %s optimiser steps of %d windows in %d epochs%s, about %s on this machine",
        label,
        data.source.space.name,
        f"{per_epoch * epochs.stop - done:,}",
        data.batch_size,
        len(epochs),
        f" and at most {last} last steps on all" if (last := model.curriculum.closing) else "",
        f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} min",
    )


def begin_at(model: AbstractModel, run: str) -> None:
    """Give a model the weights of a run, or of a shipped model, to train on with a schedule of its own.

    Raises:
        UserError: they belong to other dynamics.
    """
    from ahnn.checkpoints import require_same
    from ahnn.runs import load

    trained = load(run).trained
    require_same(f"weights {run}", {"dynamics": model.dynamics.spec}, {"dynamics": trained.spec})
    model.dynamics.load_state_dict(trained.state_dict())


def stored(cfg: DictConfig) -> bytes:
    """Return the configuration as plain YAML; what plugins take from `measurement` stays linked to it."""
    plugins = OmegaConf.to_container(cfg.plugins, resolve=False)
    return OmegaConf.to_yaml(OmegaConf.create({**plain_config(cfg), "plugins": plugins})).encode()


def judge(
    cfg: DictConfig,
    data: WindowDataModule,
    plugins: dict[str, Any],
    training: dict[str, Any],
    trainer: Trainer,
) -> float:
    """Evaluate the best weights of a run, write and show the results, and return the validation loss."""
    from lightning.pytorch.loggers import TensorBoardLogger

    from ahnn.cli.parts import report_options, robust_of
    from ahnn.evaluation import report
    from ahnn.evaluation.prepare import make_case
    from ahnn.evaluation.sinks import TensorBoardSink
    from ahnn.runs import load

    folder = Path(cfg.folder)
    run = load(folder)
    loss = math.nan if (found := run.about.get("val_loss")) is None else float(found)
    options = {"label": cfg.label, "seed": cfg.evaluation.seed, "folder": folder, "domain": run.domain}
    learned = {"uncertainty": run.uncertainty, "robust": robust_of(run)}
    case = make_case(run.dynamics, data.splits, **learned, **options)
    boards = [logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)]
    sinks = [TensorBoardSink(board, searched_settings(cfg)) for board in boards]
    report(case, plugins, {**training, "val_loss": loss}, more=sinks, **report_options(cfg))
    if boards:
        log.info("TensorBoard: tensorboard --logdir %s", folder)
    return loss


def go_on(cfg: DictConfig) -> str:
    """Return how to resume a training that was stopped."""
    from ahnn.cli.parts import is_multirun

    if cfg.get("trial") is not None:
        return "the same command continues the search"
    if not (Path(cfg.folder) / "checkpoints" / "last.ckpt").exists():
        return "there is no checkpoint yet: the same command starts from the beginning"
    one_of_several = HydraConfig.initialized() and cfg.folder != HydraConfig.get().runtime.output_dir
    seed = f" seed={cfg.seed} seeds=null" if one_of_several else ""
    seed += "" if cfg.weights is None else " weights=null"
    command = "keys of this job" if is_multirun() else "command"
    return f"resume with the same {command} and run={cfg.folder}{seed} ckpt=last"


def searched_settings(cfg: DictConfig) -> dict[str, Any]:
    """Return what a search varies, for TensorBoard's comparison of runs."""
    groups = {name: plain_config(cfg[name]) for name in ("model", "optimizer", "scheduler") if cfg[name]}
    amounts = {"window": cfg.window, "batch_size": cfg.data.batch_size, "epochs": cfg.trainer.max_epochs}
    return {**groups, **amounts, "seed": cfg.seed}


def main() -> None:
    """Entry point of `python -m ahnn.train` and `ahnn-train`."""
    os.environ.setdefault("TORCH_CPP_LOG_LEVEL", "ERROR")  # DDP warns of what is intended
    run_hydra(train)


if __name__ == "__main__":
    main()
