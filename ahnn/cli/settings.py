"""Schemas of configuration keys that are not arguments of an object, with types and limits."""

from __future__ import annotations

from dataclasses import dataclass
from inspect import signature
from typing import Annotated, Any, Literal

from omegaconf import DictConfig

from ahnn.arguments import Count, Seed, Text, Within, check_arguments, flatten
from ahnn.cli.build import plain_config
from ahnn.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Again:
    """Settings of a finished run besides its groups."""

    label: Text
    threads: Annotated[int, Within(1, 1024)]


@dataclass(frozen=True, kw_only=True)
class Splits:
    """Data settings outside sensor and simulation objects."""

    seed: Seed
    split: list[float]


@dataclass(frozen=True, kw_only=True)
class CommonSettings(Again):
    """Top-level settings besides the groups."""

    seed: Seed
    window: Count
    ckpt: str | None
    weights: str | None
    folder: str
    seeds: list[Seed] | None = None
    members: Annotated[int, Within(2, 64)] | None = None
    cuda_graphs: bool = True


@dataclass(frozen=True, kw_only=True)
class Training:
    """Trainer arguments that Lightning does not validate."""

    max_epochs: Count
    accumulate_grad_batches: Count = 1
    check_val_every_n_epoch: Count = 1
    fast_dev_run: Literal[False] = False  # True would keep no weights to evaluate


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Settings of the evaluation after training."""

    seed: Seed
    save_predictions: bool
    figures: bool = True
    detail: bool = False


SCHEMAS = {"": CommonSettings, "data": Splits, "evaluation": Evaluation, "trainer": Training}
"""Checks of settings by their place in the configuration."""


def check_again(cfg: DictConfig) -> None:
    """Check settings that also apply to finished runs; raise the same errors as `check_settings`."""
    check_keys(plain_config(cfg), {"": Again, "data": Splits, "evaluation": Evaluation})


def check_settings(cfg: DictConfig) -> None:
    """Check settings outside objects, before anything is built.

    Raises:
        UserError: a wrong type, an impossible value, or one that contradicts the chosen model.
    """
    own = [name for name, key in signature(CommonSettings).parameters.items() if key.default is key.empty]
    if missing := [name for name in (*own, *SCHEMAS) if name and name not in cfg]:  # the checks need them
        message = f"configuration: expected key {missing[0]!r}; received none"
        raise UserError(message)
    values = plain_config(cfg)
    check_keys(values, SCHEMAS)
    seeds = values.get("seeds") or []
    if len({*seeds}) < len(seeds):
        message = f"seeds: expected different seeds; received {seeds}"
        raise UserError(message)
    require_alone(values)
    require_seeds(values)
    received = flatten(values)
    for key, value in flatten(values.get("required") or {}).items():  # requirements of the model
        if received.get(key) != value:
            message = (
                f"{key}: expected {value} with model {cfg.label}; received {received.get(key)}. Choose "
                "another model"
            )
            raise UserError(message)


def require_alone(values: dict[str, Any]) -> None:
    """Raise UserError for members of an ensemble together with settings that contradict them."""
    if values.get("members") is None:
        return
    same = "members differ in their initial weights"
    for key, expected in (
        ("seeds", "null, since members use seed, seed + 1, ..."),
        ("weights", f"null, since {same}"),
    ):
        if values.get(key) is not None:
            message = f"{key}: expected {expected}; received {values[key]} with members={values['members']}"
            raise UserError(message)


def require_seeds(values: dict[str, Any]) -> None:
    """Raise UserError for an ensemble whose last seed is out of range."""
    most = 2**32 - (values.get("members") or 1)
    if values["seed"] > most:
        message = (
            f"seed: expected at most {most}, since each member has its own seed; received {values['seed']}"
        )
        raise UserError(message)


def check_keys(values: dict[str, Any], schemas: dict[str, type]) -> None:
    """Check the keys of nodes that belong to a schema; others are ignored, except in `evaluation`."""
    for who, schema in schemas.items():
        node = values[who] if who else values
        if not isinstance(node, dict):
            message = f"{who}: expected a mapping of keys to values; received {node!r}"
            raise UserError(message)
        shared = schema is not Evaluation
        own = {key: node[key] for key in signature(schema).parameters if key in node} if shared else node
        check_arguments(who, schema, own)
