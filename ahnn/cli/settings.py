"""The keys of a configuration that no object takes as its argument, each with its type and limits."""

from __future__ import annotations

from dataclasses import dataclass
from inspect import signature
from typing import Annotated, Any, Literal

from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import Count, Seed, Text, Within, check_arguments, flatten
from ahnn.cli.build import plain_config
from ahnn.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Again:
    """What a finished run takes besides its groups."""

    label: Text
    threads: Annotated[int, Within(1, 1024)]


@dataclass(frozen=True, kw_only=True)
class Splits:
    """What of the data belongs to no object that measures or simulates."""

    seed: Seed
    split: list[float]


@dataclass(frozen=True, kw_only=True)
class Settings(Again):
    """The top level beside the groups."""

    seed: Seed
    window: Count
    ckpt: str | None
    weights: str | None
    folder: str
    seeds: list[Seed] | None = None
    cuda_graphs: bool = True


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


def check_again(cfg: DictConfig, top: type = Again) -> None:
    """Check what belongs to no object and is asked of finished runs too; raises as `check_settings`."""
    check_arguments("", top, _part(cfg, top))
    check_arguments("data", Splits, _part(cfg.data, Splits, "data"))
    check_arguments("evaluation", Evaluation, plain_config(cfg.evaluation, "evaluation"))


def check_settings(cfg: DictConfig) -> None:
    """Check what belongs to no object, before anything is built.

    Raises:
        UserError: a wrong type, an impossible value, or one that contradicts the chosen model.
    """
    check_again(cfg, Settings)
    check_arguments("trainer", Training, _part(cfg.trainer, Training, "trainer"))
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


def _part(node: Any, schema: type, who: str = "") -> dict[str, Any]:
    """Return the keys of a node that belong to a schema, where others belong to somebody else."""
    if isinstance(node, DictConfig):
        node = OmegaConf.create({key: node[key] for key in signature(schema).parameters if key in node})
    return plain_config(node, who)
