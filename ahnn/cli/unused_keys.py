"""Rejection of command line keys that no part of a run reads."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from ahnn.cli.parts import is_multirun, is_one_of_several
from ahnn.cli.unreferenced_keys import keys_of, without_effect
from ahnn.data import Simulated, Source
from ahnn.data.recorded_sensor import Recorded
from ahnn.data.sensor import Sensor

if TYPE_CHECKING:
    from ahnn.jobs.prepared import Prepared

log = logging.getLogger(__name__)


BIAS = ("bias_sd", "bias_memory")
EVALUATED = ("smoother", "least_squares", "tuning")
SIMULATED = (
    "cadence",
    "times",
    "measurement",
    "measurement_sd",
    "start_sd",
    "seed",
    "beside",
)
"""Filter keys that only evaluations and fits of process noise to simulated measurements use."""
Unread = Iterator[tuple[str, str]]
"""Keys, with the reason why they are not read."""


def asked_for(texts: Iterable[str] | None) -> Iterable[str]:
    """Return overrides; None: the overrides on the command line."""
    if texts is None:
        return HydraConfig.get().overrides.task if HydraConfig.initialized() else ()
    return texts


def require_read(cfg: DictConfig, prepared: Prepared, texts: Iterable[str] | None = None) -> None:
    """Reject overrides that no part of a run reads.

    Args:
        cfg: configuration of the training.
        prepared: training run built from it.
        texts: overrides; None: the overrides on the command line.

    Raises:
        UserError: an override without effect.
    """
    texts = asked_for(texts)
    values = {key: value for key, _, value in (text.partition("=") for text in texts)}
    several = values.get("seeds", "null") != "null"
    data = unread_of_data(cfg.system, prepared.data.source, prepared.data.sensor)
    training, plugins = unread_of_training(cfg, prepared, several=several), unread_of_plugins(cfg.plugins)
    refuse((*data, *training, *plugins), texts)


def refuse(found: Iterable[tuple[str, str]], texts: Iterable[str]) -> None:
    """Reject overrides of unread keys, or warn in a sweep, whose other jobs may read them."""
    keys = keys_of(texts)
    for name, reason in found:
        for key in keys:
            if f"{key}.".startswith(f"{name}."):
                error = without_effect(key, reason)
                if not is_multirun():
                    raise error
                log.warning(str(error))


def unread_of_data(system: DictConfig, source: Source, sensor: Sensor | None) -> Unread:
    """Yield the keys that a source of trajectories and its evaluation do not read."""
    simulated = isinstance(source, Simulated)
    drawn = simulated or (sensor is not None and not isinstance(sensor, Recorded))
    yield from unless(
        ("data.trajectories", simulated, "these data are not simulated"),
        ("data.seed", drawn, "these data contain no random draws"),
        ("evaluation.seed", source.truth is not None, "starts are perturbed only in known systems"),
        (
            "system.steps",
            system.get("periods") is None,
            "system.periods sets the duration of trajectories",
        ),
    )


def unread_of_training(cfg: DictConfig, prepared: Prepared, *, several: bool) -> Unread:
    """Yield the keys that model, optimiser and trainer do not read; `several` for several seeds."""
    automatic, staged = prepared.model.stepper.automatic, prepared.data.stages is not None
    rolled = OmegaConf.select(cfg, "callbacks.rollout.count") != 0
    clipped = bool(cfg.trainer.get("gradient_clip_val"))
    derived = staged or cfg.loss.derivative > 0
    own, plain = "network" in cfg.model, "the model takes no network; its options are model.NAME"
    measured = "a loss on windows does not estimate noise; a recipe with loss.stages does"
    yield from unless(
        (
            "weights",
            cfg.ckpt is None or cfg.weights is None or is_one_of_several(cfg.folder),
            "ckpt resumes a run from its own weights",
        ),
        ("seed", not several, "seeds= replaces it"),
        ("network", own, plain),
        ("model.network", own, plain),
        ("scheduler", automatic or not cfg.scheduler, "second-order steps have no learning rate"),
        ("data.bias_sd", staged or cfg.data.get("bias_sd") is None, measured),
        ("data.correlation", staged or cfg.data.get("correlation") is None, measured),
        ("data.tails", staged or cfg.data.get("tails") is None, measured),
        ("data.noise", staged or cfg.data.get("noise") != "estimate", measured),
        ("optimizer.tolerance", not staged, "steps on measurements use the entire batch"),
        ("loss.order", derived, "with loss.derivative=0 no derivatives are formed"),
        ("callbacks.rollout", not staged, "measurements have no true start to roll out from"),
        ("callbacks.rollout.every", rolled, "callbacks.rollout.count=0 disables rollouts"),
        ("trainer.gradient_clip_algorithm", clipped, "trainer.gradient_clip_val is not set"),
    )


def of_plugins(nodes: DictConfig) -> Iterator[tuple[str, DictConfig]]:
    """Yield name and options of each plugin; invalid ones are rejected on construction."""
    yield from ((str(name), node) for name, node in nodes.items() if isinstance(node, DictConfig))


def unread_of_plugins(nodes: DictConfig) -> Unread:
    """Yield filter keys made ineffective by another key."""
    for name, options in of_plugins(nodes):
        yield from unless(
            (f"plugins.{name}.patience", options.get("gate", 0) is not None, "gate=null rejects nothing"),
            (f"plugins.{name}.cadence", options.get("times") is None, "times sets the measurement times"),
        )


def unread_online(nodes: DictConfig, *, covariance: bool, named: bool = False) -> Unread:
    """Yield the keys that a stream does not read.

    Args:
        nodes: filter nodes.
        covariance: whether the covariance of the weights is known.
        named: whether named sensors replace the sensor of the run.
    """
    yield from (found for found in unread_of_plugins(nodes) if not found[0].endswith(".patience"))
    noises = [options.get("process_noise") for _, options in of_plugins(nodes)]
    if named and not any(_is_fitted(noise, covariance=covariance) for noise in noises):
        yield "measurement", "sensors.NAME defines what each sensor measures"
    for name, options in of_plugins(nodes):
        yield from ((f"plugins.{name}.{key}", "a stream is only filtered") for key in EVALUATED)
        yield from (
            (f"plugins.{name}.{key}", f"the sensors of a stream define it (measurement.{key})")
            for key in BIAS
        )
        if not _is_fitted(options.get("process_noise"), covariance=covariance):
            yield from ((f"plugins.{name}.{key}", "no process noise is fitted to data") for key in SIMULATED)


def _is_fitted(noise: Any, *, covariance: bool) -> bool:
    """Return whether a process noise is fitted to data."""
    if isinstance(noise, DictConfig):
        return noise.get("size") is None or noise.get("memory") is None
    return isinstance(noise, str) and not (covariance and noise == "parameter_error")


def unless(*rows: tuple[str, bool, str]) -> Unread:
    """Yield key and reason of each row (key, whether it is read, reason) whose key is not read."""
    yield from ((name, reason) for name, is_read, reason in rows if not is_read)
