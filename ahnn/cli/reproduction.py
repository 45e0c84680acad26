"""The jobs of a reproduction, composed before any of them runs, and what is in their folders already."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import flatten
from ahnn.cli import commandline
from ahnn.cli.trust import read_plain
from ahnn.data.splits import split_sizes
from ahnn.errors import UserError

SYSTEMS = ("mass_spring", "molniya")
BUDGETS = ("smoke", "laptop", "paper")
ITS_OWN = ("sweep", "ckpt", "seeds", "folder", "label", "trial", "hydra.sweep.dir", "hydra.sweep.subdir")
"""What the command itself decides, job by job."""
MACHINE = ("run", "ckpt", "threads", "data.cache")
"""Keys that may differ between two starts of one command."""
SHARED = ("system", "data", "trainer", "scheduler", "plugins", "evaluation")
"""Parts that all runs of a folder have in common, but for the keys that follow the seed."""


class Plan(NamedTuple):
    """What a command asks for.

    Attributes:
        folder: of the run folders.
        overrides: of the sweep.
        jobs: name of the run folder and configuration of each job, in order.
        steps: of the optimiser, the same for every job.
    """

    folder: Path
    overrides: list[str]
    jobs: dict[str, DictConfig]
    steps: int

    def announcement(self) -> str:
        """Return what is going to happen, on one line."""
        first = next(iter(self.jobs.values()))
        done = sum(is_finished(self.folder / name, first.evaluation.save_predictions) for name in self.jobs)
        return (
            f"{first.system.name}: {len(self.jobs)} runs of {self.steps:,} optimiser steps of "
            f"{first.data.batch_size} windows in {self.folder}; {done} are finished"
        )


def plan(arguments: list[str], usage: str) -> Plan:
    """Return the jobs of a command line.

    Raises:
        UserError: no system or budget of the paper, what the command decides itself, or jobs that do not compose.
    """
    given = {text.partition("=")[0]: commandline.parse(text).input_line for text in arguments}
    if wrong := given.keys() & {*ITS_OWN}:
        message = f"{sorted(wrong)[0]}: expected none, since reproduce sets it for each run. Leave it out"
        raise UserError(message)
    for key, known in (("system", SYSTEMS), ("budget", BUDGETS)):
        value = str(given.get(key, "=nothing")).partition("=")[2]
        if value not in known:
            message = f"{key}: expected one of {', '.join(known)}; received {value}. {usage}"
            raise UserError(message)
    budget = str(given.pop("budget")).partition("=")[2]
    system = str(given["system"]).partition("=")[2]
    folder = Path(
        str(given.pop("run", f"run=runs/reproduce/{system}_{budget}")).partition("=")[2].strip("'\"")
    )
    overrides = [f"sweep=reproduce_{budget}", *map(str, given.values()), f"run='{folder}'"]
    jobs = composed(overrides)
    if "data.windows_per_epoch" not in given and all(c.data.windows_per_epoch is None for c in jobs):
        overrides.append(f"data.windows_per_epoch={min(map(windows, jobs))}")
        jobs = composed(overrides)
    steps = {steps_of(cfg) for cfg in jobs}
    if len(steps) > 1:
        message = (
            f"steps: expected as many for every model; received {sorted(steps)}. Lower data.windows_per_epoch"
        )
        raise UserError(message)
    named = {f"{cfg.label}_{cfg.seed}": cfg for cfg in jobs}
    return Plan(folder, overrides, named, steps.pop())


def composed(overrides: list[str]) -> list[DictConfig]:
    """Return the configuration of each job that Hydra's sweeper makes of overrides."""
    loader = commandline.config_loader()
    for text in overrides:
        commandline.alternatives(commandline.parse(text), loader)
    sweep = [text for text in overrides if commandline.parse(text).is_sweep_override()]
    base = commandline.compose(loader, "train", [text for text in overrides if text not in sweep])
    params = [f"{key}={value}" for key, value in base.hydra.sweeper.params.items()]
    parsed = OverridesParser.create(config_loader=loader).parse_overrides([*params, *overrides])
    ((*batch,),) = BasicSweeper.split_arguments(parsed, None)
    jobs = [commandline.compose(loader, "train", list(job)) for job in batch]
    for cfg in jobs:
        OmegaConf.set_struct(cfg, False)
        del cfg["hydra"]
    return jobs


def windows(cfg: DictConfig) -> int:
    """Return the training windows that there are, as far as the steps of a trajectory are known."""
    train = split_sizes(cfg.data.trajectories, list(cfg.data.split))[0]
    return train * (cfg.system.steps - cfg.window + 1)


def steps_of(cfg: DictConfig) -> int:
    """Return the optimiser steps of a training."""
    drawn = min(windows(cfg), cfg.data.windows_per_epoch or windows(cfg))
    batches = -(-drawn // cfg.data.batch_size)
    return -(-batches // cfg.trainer.get("accumulate_grad_batches", 1)) * cfg.trainer.max_epochs


def is_finished(folder: Path, predictions: bool) -> bool:
    """Return whether a run has all that its evaluation writes; predictions are the last of it."""
    names = ["metrics.json", *(["predictions.safetensors"] if predictions else [])]
    return all((folder / name).is_file() for name in names)


def require_same_settings(made: Plan) -> None:
    """Check that the runs in a folder are of the same command, on whatever machine.

    Raises:
        UserError: one of them has other settings.
    """
    first = next(iter(made.jobs.values()))
    for path in sorted(made.folder.glob("*/config.yaml")):
        found = read_plain(path)
        cfg = made.jobs.get(path.parent.name)
        wanted = settings(cfg or first, str(found.get("folder")))
        if cfg is None:  # of a model or seed that this command leaves out
            found, wanted = ({key: whole.get(key) for key in SHARED} for whole in (found, wanted))
        old, new = flatten(found), flatten(wanted)
        loose = {*MACHINE, *(() if cfg else ("data.order_seed", "evaluation.label"))}
        changed = [
            key
            for key in sorted(old.keys() | new.keys())
            if key not in loose and old.get(key) != new.get(key)
        ]
        if changed:
            key = changed[0]
            more = f" (and {len(changed) - 1} more)" if len(changed) > 1 else ""
            message = (
                f"run {made.folder}: expected the settings of {path.parent.name}, {key}={old.get(key)}; received "
                f"{key}={new.get(key)}{more}. Take those, or another folder with run="
            )
            raise UserError(message)


def settings(cfg: DictConfig, folder: str) -> dict[str, Any]:
    """Return what a training in a folder writes into its config.yaml."""
    import yaml

    from ahnn.train import stored

    own = cfg.copy()
    own.folder = folder
    return yaml.safe_load(stored(own))
