"""Task of `python -m ahnn.train`: training with evaluation, for one or several seeds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from ahnn.cli.early_stops import ended, held, interruptible
from ahnn.cli.preflight import begin, require_new
from ahnn.files import claimed, require_writable

if TYPE_CHECKING:
    from ahnn.data import Source
    from ahnn.jobs.prepared import Prepared


def train(cfg: DictConfig) -> float:
    """Train with one seed or with several; return the mean of the best validation losses.

    Several `seeds` have separate folders, such as seed_7, inside the run folder, as do `members`, which are
    trained together.
    """
    begin(cfg)
    if cfg.get("members"):
        from ahnn.cli.ensemble_training import train_members

        return train_members(cfg)
    parts = [of_seed(cfg, seed) for seed in cfg.seeds] if cfg.seeds else [cfg]
    for part in parts:
        require_new(Path(part.folder), part.ckpt)
    with held():
        from ahnn.cli.parts import is_multirun, is_one_of_several

    with ended(lambda: go_on(parts[0])) if is_one_of_several(parts[0].folder) else nullcontext():
        losses = [train_once(part) for part in parts]
    from ahnn.jobs.closing import require_converged  # imported late, like the training code

    if not is_multirun():  # in a sweep the table shows each job, and a search uses the losses
        require_converged([Path(part.folder) for part in parts])
    return sum(losses) / len(losses)


def of_seed(cfg: DictConfig, seed: int) -> DictConfig:
    """Return the configuration of one seed among several."""
    part = cfg.copy()
    part.seed, part.seeds, part.folder = seed, None, f"{cfg.folder}/seed_{seed}"
    return part


def check(cfg: DictConfig) -> None:
    """Run all checks that precede data generation; called once before the first trial of a sweep.

    Raises:
        UserError: an invalid job.
    """
    begin(cfg)
    with held():
        if cfg.get("members"):
            from ahnn.cli.ensemble_training import prepare_members

            prepare_members(cfg)
            return
        from ahnn.cli.prepare import prepare

        prepare(of_seed(cfg, cfg.seeds[0]) if cfg.seeds else cfg)


train.check = check  # pyright: ignore[reportFunctionMemberAccess] - the sweeper receives only this function


def train_once(
    cfg: DictConfig,
    source: Source | None = None,
    asked: Sequence[str] | None = None,
    evaluation: Callable[[Prepared, float], float] | None = None,
) -> float:
    """Train and evaluate once; return the best validation loss, the objective of a search.

    With several devices the first process evaluates and writes the results; the others return NaN, which is
    ignored.

    Args:
        cfg: configuration of one job.
        source: source of the trajectories; None: the system of the configuration.
        asked: overrides of the configuration; None: the overrides on the command line.
        evaluation: evaluation of the fitted run, given the seconds of its steps; None: scores and reports.
    """
    with held():
        from ahnn.cli.prepare import prepare
        from ahnn.jobs.fitting import fit

        prepared = prepare(cfg, source, asked)
    folder, trainer = prepared.folder, prepared.trainer
    prepared.data.train_dataloader()  # last check: files are written after this

    require_writable(folder)
    with claimed(folder) if trainer.is_global_zero else nullcontext():
        with interruptible(trainer, lambda: go_on(cfg)):
            seconds = fit(prepared)
        if not trainer.is_global_zero:
            return math.nan
        from ahnn.jobs.closing import is_concluded, judge

        evaluated = f"evaluate it with python -m ahnn.evaluate run={folder}"
        with interruptible(trainer, lambda: evaluated if is_concluded(prepared) else go_on(cfg)):
            return (evaluation or judge)(prepared, seconds)


def go_on(cfg: DictConfig) -> str:
    """Return the command that resumes a stopped run, or several: those that had not begun begin."""
    from ahnn.cli.parts import is_multirun, is_one_of_several

    if cfg.get("trial") is not None:
        return "repeat the command to continue the search"
    if is_one_of_several(cfg.folder):
        own = HydraConfig.get()
        folder = own.sweep.dir if is_multirun() else own.runtime.output_dir
        return f"resume with the same command and run={folder} ckpt=last"
    if not (Path(cfg.folder) / "checkpoints" / "last.ckpt").exists():
        return "there is no checkpoint yet: repeating the command starts from the beginning"
    weights = "" if cfg.weights is None else " weights=null"
    return f"resume with the same command and run={cfg.folder}{weights} ckpt=last"
