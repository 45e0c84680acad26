"""Jobs of a sweep that would train the same weights: said before the first begins."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Any

from omegaconf import DictConfig, OmegaConf

log = logging.getLogger(__name__)

NAMES = ("label", "model_label", "run", "folder", "hydra", "required")
"""What says how a training is called, and not what it does."""


def warn_of_twins(jobs: Iterable[DictConfig], names: Iterable[str]) -> None:
    """Warn of each job whose training is that of one before it."""
    seen: dict[str, str] = {}
    for cfg, name in zip(jobs, names, strict=True):
        first = seen.setdefault(repr(decisive(cfg)), name)
        if first != name:
            log.warning("two jobs of the sweep train the same weights: %r is %r", name, first)


def decisive(cfg: DictConfig) -> dict[str, Any]:
    """Return what a training depends on; the window W of recursive predictions only where there are any."""
    plain: Any = OmegaConf.to_container(cfg, resolve=False)
    return {
        key: plain[key] for key in sorted(plain) if key not in NAMES and (key != "window" or _recurs(cfg))
    }


def _recurs(cfg: DictConfig) -> bool:
    """Return whether recursive predictions are learned from in the last epoch, or choose the best weights."""
    fraction, epochs = (OmegaConf.select(cfg, key) for key in ("loss.derivative", "trainer.max_epochs"))
    if fraction is None:  # measurements: stages say how long segments are
        return False
    chosen = OmegaConf.select(cfg, "callbacks.best.monitor") != "val/rollout"
    known = isinstance(epochs, int) and isinstance(fraction, int | float)  # types are checked in each job
    return chosen or not known or epochs - 1 >= fraction * epochs
