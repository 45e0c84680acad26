"""Keys of a command line that the parts of a training leave unread: they are refused, and never dropped."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from ahnn.cli.parts import is_multirun
from ahnn.cli.referenced import keys_of, without_effect
from ahnn.data import Simulated, Source
from ahnn.data.recorded import Recorded
from ahnn.data.sensor import Sensor

if TYPE_CHECKING:
    from ahnn.jobs.prepared import Prepared

log = logging.getLogger(__name__)


Unread = Iterator[tuple[str, str]]
"""Keys, and why they are not read."""


def require_read(cfg: DictConfig, prepared: Prepared, texts: Iterable[str] | None = None) -> None:
    """Refuse overrides that none of the parts of a training reads.

    Args:
        cfg: of the training.
        prepared: built from it.
        texts: overrides; None takes those of the command line.

    Raises:
        UserError: one without effect.
    """
    if texts is None:
        texts = HydraConfig.get().overrides.task if HydraConfig.initialized() else ()
    values = {key: value for key, _, value in (text.partition("=") for text in texts)}
    several = values.get("seeds", "null") != "null"
    data = unread_of_data(cfg, prepared.data.source, prepared.data.sensor)
    training = unread_of_training(cfg, prepared, several=several)
    refuse((*data, *training), texts)


def refuse(found: Iterable[tuple[str, str]], texts: Iterable[str]) -> None:
    """Refuse overrides of keys that are not read, or warn in a sweep, whose other jobs may read them."""
    keys = keys_of(texts)
    for name, reason in found:
        for key in keys:
            if f"{key}.".startswith(f"{name}."):
                error = without_effect(key, reason)
                if not is_multirun():
                    raise error
                log.warning(str(error))


def unread_of_data(cfg: DictConfig, source: Source, sensor: Sensor | None) -> Unread:
    """Yield the keys that a source of trajectories and its evaluation leave unread."""
    simulated = isinstance(source, Simulated)
    drawn = simulated or (sensor is not None and not isinstance(sensor, Recorded))
    yield from unless(
        ("data.trajectories", simulated, "these data are not simulated"),
        ("data.seed", drawn, "nothing is drawn for these data"),
        ("evaluation.seed", source.truth is not None, "starts are perturbed only in known systems"),
        ("system.steps", cfg.system.get("periods") is None, "system.periods says how long trajectories are"),
    )


def unread_of_training(cfg: DictConfig, prepared: Prepared, *, several: bool) -> Unread:
    """Yield the keys that model, optimiser and trainer leave unread; `several` seeds are named."""
    automatic, staged = prepared.model.stepper.automatic, prepared.data.stages is not None
    rolled = OmegaConf.select(cfg, "callbacks.rollout.count") != 0
    clipped = bool(cfg.trainer.get("gradient_clip_val"))
    derived = staged or cfg.loss.derivative > 0
    yield from unless(
        ("weights", cfg.ckpt is None or cfg.weights is None, "ckpt resumes a training from its own weights"),
        ("seed", not several, "seeds says which ones"),
        ("scheduler", automatic or not cfg.scheduler, "second-order steps have no learning rate"),
        ("optimizer.tolerance", not staged, "steps on measurements hold no part of a batch back"),
        ("loss.order", derived, "with loss.derivative=0 no derivatives are formed"),
        ("callbacks.rollout", not staged, "measurements have no true start to roll out from"),
        ("callbacks.rollout.every", rolled, "callbacks.rollout.count=0 rolls out nothing"),
        ("trainer.gradient_clip_algorithm", clipped, "trainer.gradient_clip_val is not set"),
    )


def unless(*rows: tuple[str, bool, str]) -> Unread:
    """Yield the keys of rows that are not read, with the reason."""
    yield from ((name, reason) for name, is_read, reason in rows if not is_read)
