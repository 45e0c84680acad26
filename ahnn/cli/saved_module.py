"""Configuration of a filter for a module saved by `ahnn.save`, which no command has trained."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from ahnn.cli.reevaluation import GROUPS, Request, run_config
from ahnn.errors import UserError
from ahnn.stored import SAVED
from ahnn.types import Trajectories


class NoData:
    """Source of the unknown data of a saved module."""

    truth = None

    def read(self) -> Trajectories:
        """Raise UserError: process noise cannot be fitted."""
        message = (
            "process_noise: expected standard deviations of the error of one step, since a module saved by "
            "ahnn.save has no data to which they can be fitted; received none. Set for example "
            "plugins.ukf.process_noise=[POSITION,VELOCITY]"
        )
        raise UserError(message)


def is_saved(folder: Path) -> bool:
    """Return whether a folder contains a saved module instead of a run."""
    return (folder / SAVED).is_file() and not (folder / "config.yaml").exists()


def filter_config(folder: Path, request: Request) -> DictConfig:
    """Return the configuration of a run, or the default one with the options of a saved module.

    Raises:
        UserError: as `run_config`, or an override that has no effect on a filter.
    """
    if not is_saved(folder):
        return run_config(folder, request)
    from ahnn.cli.compose import composed

    for text in request.overrides:
        if (key := text.partition("=")[0].lstrip("+~").partition(".")[0]) not in GROUPS:
            message = f"{key}: expected options of {' or '.join(GROUPS)} for a saved module; received {text}"
            raise UserError(message)
    cfg: Any = composed("train", request.overrides)
    cfg.system = {"_target_": f"{__name__}.{NoData.__name__}"}
    return cfg
