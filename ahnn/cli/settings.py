"""The keys of a configuration that no object takes as its argument, each with its type and limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import Count, Seed, Within, check_arguments
from ahnn.cli.build import plain_config
from ahnn.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The top level beside the groups."""

    seed: Seed
    threads: Annotated[int, Within(1, 1024)]
    window: Count
    label: str
    ckpt: str | None
    weights: str | None
    folder: str
    seeds: list[Seed] | None = None


@dataclass(frozen=True, kw_only=True)
class Training:
    """Arguments of the trainer that Lightning takes unseen."""

    max_epochs: Count
    accumulate_grad_batches: Count = 1
    check_val_every_n_epoch: Count = 1
    fast_dev_run: Literal[False] = False  # it keeps no weights to judge


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """What happens after the fit."""

    seed: Seed
    save_predictions: bool
    figures: bool = True
    detail: bool = False


@dataclass(frozen=True, kw_only=True)
class Again:
    """What a finished run takes besides its groups."""

    label: str
    threads: Annotated[int, Within(1, 1024)]


def check_again(cfg: DictConfig) -> None:
    """Check what an evaluation of a finished run is given; raises UserError for a wrong type or value."""
    _check({"": Again, "evaluation": Evaluation}, cfg)


def check_settings(cfg: DictConfig) -> None:
    """Check what belongs to no object, before anything is built.

    Raises:
        UserError: a wrong type, an impossible value, or one that contradicts the chosen model.
    """
    _check({"": Settings, "trainer": Training, "evaluation": Evaluation}, cfg)
    if cfg.get("seeds") and len({*cfg.seeds}) < len(cfg.seeds):
        message = f"seeds: expected different ones; received {list(cfg.seeds)}"
        raise UserError(message)
    _check_required(cfg, plain_config(cfg.get("required") or OmegaConf.create()))


def _check(schemas: dict[str, type], cfg: DictConfig) -> None:
    for who, schema in schemas.items():
        node = cfg[who] if who else cfg
        if not isinstance(node, DictConfig):
            message = f"{who}: expected keys with values; received {node!r}"
            raise UserError(message)
        keys = node if schema is Evaluation else schema.__annotations__
        values = plain_config(OmegaConf.create({str(key): node[key] for key in keys if key in node}))
        check_arguments(who, schema, values)


def _check_required(cfg: DictConfig, required: dict[str, Any], prefix: str = "") -> None:
    """Compare values with those that the choice of a model implies, `required` in its file."""
    for name, value in required.items():
        key = f"{prefix}{name}"
        if isinstance(value, dict):
            _check_required(cfg, value, f"{key}.")
        elif (received := OmegaConf.select(cfg, key)) != value:
            message = (
                f"{key}: expected {value} with model {cfg.label}; received {received}. Choose another model"
            )
            raise UserError(message)
