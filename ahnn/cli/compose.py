"""One job composed without a command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from ahnn.errors import UserError
from ahnn.paths import conf_dir


def compose_job(overrides: Sequence[str], folder: Path) -> DictConfig:
    """Return the configuration of a training in a folder, without plugins unless they are asked for.

    Raises:
        UserError: overrides that do not compose.
    """
    defaults = [] if any(o.startswith("plugins=") for o in overrides) else ["plugins=none"]
    try:
        with initialize_config_dir(str(conf_dir()), version_base="1.3"):
            cfg = compose("train", [*defaults, *overrides])
    except (HydraException, OmegaConfBaseException) as error:
        message = f"overrides: {' '.join(str(error).split())}"
        raise UserError(message) from error
    OmegaConf.set_struct(cfg, False)
    cfg.folder = str(folder)
    return cfg
