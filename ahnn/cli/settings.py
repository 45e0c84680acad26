"""The keys of a configuration that no object takes as its argument, each with its type and limits."""

from __future__ import annotations

from dataclasses import dataclass
from inspect import signature
from typing import Annotated, Literal

from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import Count, Seed, Within, check_arguments, flatten
from ahnn.cli.build import plain_config
from ahnn.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Again:
    """What a finished run takes besides its groups."""

    label: str
    threads: Annotated[int, Within(1, 1024)]


@dataclass(frozen=True, kw_only=True)
class Settings(Again):
    """The top level beside the groups."""

    seed: Seed
    window: Count
    ckpt: str | None
    weights: str | None
    folder: str
    seeds: list[Seed] | None = None
    compile: Literal["auto"] | bool = "auto"


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
    required = plain_config(cfg.get("required") or OmegaConf.create())  # what the choice of a model implies
    for key, value in flatten(required).items():
        if (received := OmegaConf.select(cfg, key)) != value:
            message = (
                f"{key}: expected {value} with model {cfg.label}; received {received}. Choose another model"
            )
            raise UserError(message)


def _check(schemas: dict[str, type], cfg: DictConfig) -> None:
    for who, schema in schemas.items():
        node = cfg[who] if who else cfg
        own = node if schema is Evaluation or not isinstance(node, DictConfig) else _part(node, schema)
        check_arguments(who, schema, plain_config(own, who))


def _part(node: DictConfig, schema: type) -> DictConfig:
    """Return the keys of a node that belong to a schema, where others belong to somebody else."""
    return OmegaConf.create({key: node[key] for key in signature(schema).parameters if key in node})
