"""Composition of jobs without a command line: any configuration, a training run, or a sweep."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf

from ahnn.cli.commandline import alternatives, compose, config_loader, parse, worded
from ahnn.cli.unreferenced_keys import require_referenced
from ahnn.errors import UserError

LEARNS = ("sensor", "recipe", "loss", "experiment")
"""Groups that define how to learn from noisy data."""


def with_recorded(texts: Sequence[str]) -> list[str]:
    """Add sensor=recorded for recorded data with noise if no option defines how to learn from it."""
    noisy = any(text.startswith("data.noise=") and text != "data.noise=null" for text in texts)
    if "system=files" not in texts or not noisy or {text.partition("=")[0] for text in texts} & {*LEARNS}:
        return [*texts]
    place = texts.index("system=files") + 1
    return [*texts[:place], "sensor=recorded", *texts[place:]]


def composed(name: str, overrides: Sequence[str], *, partly: bool = False) -> DictConfig:
    """Return the configuration NAME of conf/ with overrides; `partly` if only some nodes are used.

    Raises:
        UserError: the overrides do not compose, or one of them has no effect.
    """
    loader, texts = config_loader(), with_recorded([worded(text) for text in overrides])
    for text in texts:
        override = parse(text)
        if override.is_sweep_override():
            key, _, value = text.partition("=")
            message = f"{text!r}: expected one value; received several. A list has brackets: {key}=[{value}]"
            raise UserError(message)
        alternatives(override, loader)
    cfg = compose(loader, name, texts)
    if not partly:
        require_referenced([cfg], texts)
    return _opened(cfg)


def compose_job(overrides: Sequence[str], folder: Path) -> DictConfig:
    """Compose a training run in a folder, by default without plugins; raises UserError as `composed` does."""
    defaults = [] if any(text.startswith("plugins=") for text in overrides) else ["plugins=none"]
    cfg = composed("train", [*defaults, *overrides])
    cfg.folder = cfg.run = str(folder).replace("${", r"\${")  # prevents interpolation of the folder name
    return cfg


def compose_sweep(overrides: Sequence[str]) -> list[DictConfig]:
    """Compose the jobs of Hydra's basic sweeper in order; raises UserError if overrides do not compose."""
    loader = config_loader()
    single = [text for text in overrides if not parse(text).is_sweep_override()]
    for text in overrides:
        alternatives(parse(text), loader)
    params = compose(loader, "train", single).hydra.sweeper.params
    texts = [*(f"{key}={value}" for key, value in params.items()), *overrides]
    parsed = OverridesParser.create(config_loader=loader).parse_overrides(texts)
    (jobs,) = BasicSweeper.split_arguments(parsed, None)
    return [_opened(compose(loader, "train", job)) for job in jobs]


def _opened(cfg: DictConfig) -> DictConfig:
    """Return a configuration that accepts new keys, without Hydra's own node."""
    OmegaConf.set_struct(cfg, False)
    del cfg["hydra"]
    return cfg
