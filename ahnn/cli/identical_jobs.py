"""Detection of sweep jobs that train identically, before the first job begins."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Any

from omegaconf import DictConfig, OmegaConf

log = logging.getLogger(__name__)

NAMES = ("label", "model_label", "run", "folder", "hydra", "required")
"""Keys that label a run without affecting the training."""


def warn_of_twins(jobs: Iterable[DictConfig], names: Iterable[str]) -> None:
    """Warn of each job that trains the same weights as an earlier job."""
    seen: dict[str, str] = {}
    for cfg, name in zip(jobs, names, strict=True):
        first = seen.setdefault(repr(decisive(cfg)), name)
        if first != name:
            log.warning("two jobs of the sweep train the same weights: %r and %r", name, first)


def decisive(cfg: DictConfig) -> dict[str, Any]:
    """Return the settings that determine the training, with the window if recursive predictions are used."""
    plain: Any = OmegaConf.to_container(cfg, resolve=False)
    return {
        key: plain[key] for key in sorted(plain) if key not in NAMES and (key != "window" or _recurs(cfg))
    }


def _recurs(cfg: DictConfig) -> bool:
    """Return whether recursive predictions are used in the last epoch or for selection of weights."""
    fraction = OmegaConf.select(cfg, "loss.derivative")
    if fraction is None:  # for measurements the stages define the segment lengths
        return False
    chosen = OmegaConf.select(cfg, "callbacks.best.monitor") != "val/rollout"
    return chosen or not isinstance(fraction, int | float) or fraction < 1  # types are validated in each job
