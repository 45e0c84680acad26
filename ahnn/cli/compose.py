"""One job composed without a command line, or all jobs of a sweep before it starts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf

from ahnn.cli.commandline import alternatives, compose, config_loader, parse


def compose_job(overrides: Sequence[str], folder: Path) -> DictConfig:
    """Return the configuration of a training in a folder, without plugins unless they are asked for.

    Raises:
        UserError: overrides that do not compose.
    """
    loader = config_loader()
    for text in overrides:
        alternatives(parse(text), loader)
    defaults = [] if any(text.startswith("plugins=") for text in overrides) else ["plugins=none"]
    cfg = compose(loader, "train", [*defaults, *overrides])
    OmegaConf.set_struct(cfg, False)
    del cfg["hydra"]
    cfg.folder = str(folder)
    return cfg


def compose_sweep(overrides: Sequence[str]) -> list[DictConfig]:
    """Return the configuration of each job that Hydra's basic sweeper makes of overrides, in its order.

    Raises:
        UserError: overrides that do not compose.
    """
    loader = config_loader()
    single = [text for text in overrides if not parse(text).is_sweep_override()]
    for text in overrides:
        alternatives(parse(text), loader)
    params = compose(loader, "train", single).hydra.sweeper.params
    texts = [*(f"{key}={value}" for key, value in params.items()), *overrides]
    parsed = OverridesParser.create(config_loader=loader).parse_overrides(texts)
    jobs = [
        compose(loader, "train", job) for batch in BasicSweeper.split_arguments(parsed, None) for job in batch
    ]
    for cfg in jobs:
        OmegaConf.set_struct(cfg, False)
        del cfg["hydra"]
    return jobs
