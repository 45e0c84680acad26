"""One job composed without a command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

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
