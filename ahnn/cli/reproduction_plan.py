"""Plan of a reproduction of the paper's tables: runs and their state in the folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import yaml
from omegaconf import DictConfig

from ahnn.arguments import flatten
from ahnn.cli.commandline import pair, parse
from ahnn.cli.compose import compose_sweep
from ahnn.contents import read_plain
from ahnn.errors import UserError, WrongUsage

SYSTEMS = ("mass_spring", "molniya")
BUDGETS = ("smoke", "laptop", "paper")
ITS_OWN = ("sweep", "ckpt", "seeds", "folder", "label", "trial", "hydra.sweep.dir", "hydra.sweep.subdir")
"""Keys set by the command itself for each run."""
MACHINE = {"run", "ckpt", "threads", "data.cache"}
"""Keys that may differ between two starts of one command."""
SHARED = ("system", "data", "trainer", "scheduler", "plugins", "evaluation")
"""Parts common to all runs of a folder, except for the seed of the batch order."""


class Plan(NamedTuple):
    """Plan of a command.

    Attributes:
        folder: parent of the run folders.
        overrides: overrides of the sweep.
        runs: name of the run folder and configuration, in order.
        steps: number of optimiser steps, equal in every run.
    """

    folder: Path
    overrides: list[str]
    runs: dict[str, DictConfig]
    steps: int

    def finished(self) -> list[str]:
        """Return the names of finished runs."""
        return [name for name, cfg in self.runs.items() if is_finished(self.folder / name, cfg)]

    def announcement(self) -> str:
        """Return a one-line announcement of the plan."""
        first = next(iter(self.runs.values()))
        done = len(self.finished())
        return (
            f"{first.system.name}: {len(self.runs)} runs of {self.steps:,} optimiser steps of "
            f"{first.data.batch_size} windows in {self.folder}"
            + (f", {done} of them finished" if done else "")
        )


def plan(arguments: list[str]) -> Plan:
    """Build the plan of a command line.

    Raises:
        UserError: a system or budget that is not in the paper, a key set by the command itself, or runs that
            do not compose or differ in their steps.
    """
    given = {text.partition("=")[0]: text for text in arguments if parse(text)}
    if wrong := [key for key in given if key in ITS_OWN]:
        message = (
            f"{wrong[0]}: expected none, since reproduce sets it for each run; received {given[wrong[0]]!r}"
        )
        raise UserError(message)
    values = dict(pair(given[key]) for key in ("system", "budget", "run") if key in given)
    for key, known in (("system", SYSTEMS), ("budget", BUDGETS)):
        if (value := values.get(key, "nothing")) not in known:
            message = f"{key}: expected one of {', '.join(known)}; received {value}"
            raise WrongUsage(message)
    folder = Path(str(values.get("run", f"runs/reproduce/{values['system']}_{values['budget']}")))
    own = [f"sweep=reproduce_{values['budget']}", f"run='{folder}'"]
    overrides = [*(text for key, text in given.items() if key not in ("budget", "run")), *own]
    jobs = compose_sweep(overrides)
    if all(cfg.data.windows_per_epoch is None for cfg in jobs):  # models with longer windows have fewer
        overrides.append(f"data.windows_per_epoch={min(map(windows, jobs))}")
        jobs = compose_sweep(overrides)
    steps = sorted({steps_of(cfg) for cfg in jobs})
    if len(steps) > 1:
        message = (
            f"data.windows_per_epoch: expected equal numbers of steps for all models; received {steps}. "
            "Lower it"
        )
        raise UserError(message)
    return Plan(folder, overrides, {f"{cfg.label}_{cfg.seed}": cfg for cfg in jobs}, steps[0])


def windows(cfg: DictConfig) -> int:
    """Return the number of training windows."""
    from ahnn.data.splits import split_sizes

    train = split_sizes(cfg.data.trajectories, list(cfg.data.split))[0]
    return train * (cfg.system.steps - cfg.window + 1)


def steps_of(cfg: DictConfig) -> int:
    """Return the number of optimiser steps of a training run."""
    there = windows(cfg)
    batches = -(-min(there, cfg.data.windows_per_epoch or there) // cfg.data.batch_size)
    return -(-batches // cfg.trainer.get("accumulate_grad_batches", 1)) * cfg.trainer.max_epochs


def is_finished(folder: Path, cfg: DictConfig) -> bool:
    """Return whether a run has all files of its evaluation, of which predictions are written last."""
    names = ["metrics.json", *(["predictions.safetensors"] if cfg.evaluation.save_predictions else [])]
    return all((folder / name).is_file() for name in names)


def require_same_settings(made: Plan) -> None:
    """Check that the runs in a folder come from the same command, on any machine.

    Raises:
        UserError: one of them has other settings.
    """
    from ahnn.checkpoints import require_same

    first = next(iter(made.runs.values()))
    for path in sorted(made.folder.glob("*/config.yaml")):
        found, cfg, loose = read_plain(path), made.runs.get(path.parent.name), MACHINE
        wanted = settings(cfg or first, str(found.get("folder")))
        if cfg is None:  # a model or a seed that this command omits
            found, wanted = ({key: whole.get(key) for key in SHARED} for whole in (found, wanted))
            loose = MACHINE | {"data.order_seed"}
        old, new = (
            {key: value for key, value in flatten(whole).items() if key not in loose}
            for whole in (found, wanted)
        )
        require_same(f"run {path.parent}", old, new, "Choose another folder with run=")


def settings(cfg: DictConfig, folder: str) -> dict[str, Any]:
    """Return the content of a run's config.yaml."""
    from ahnn.cli.build import stored

    own = cfg.copy()
    own.folder = folder
    return yaml.safe_load(stored(own))
