"""Rejection of unreferenced keys in shared nodes."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import flatten
from ahnn.errors import UserError

BY_REFERENCE = ("recipe", "experiment", "measurement", "integrator", "model_label")
"""Nodes that are not built: other keys take their values from them."""
REFERENCE = re.compile(r"\$\{(?:oc\.select:)?([\w.]+)")


def keys_of(texts: Iterable[str]) -> list[str]:
    """Return the keys and groups set by overrides; group options may be relocated by `@`."""
    pairs = (text.partition("=") for text in texts if not text.startswith("~"))  # these delete keys
    return [key.lstrip("+").rpartition("@")[2] for key, equals, _ in pairs if equals]


def unreferenced(cfg: DictConfig, keys: Iterable[str]) -> list[str]:
    """Return the keys in shared nodes to which no other key refers."""
    values: dict[str, Any] = flatten(OmegaConf.to_container(cfg, resolve=False))  # pyright: ignore[reportArgumentType]
    references, found = {key: REFERENCE.findall(str(value)) for key, value in values.items()}, set[str]()
    todo = [name for key in values if key.partition(".")[0] not in BY_REFERENCE for name in references[key]]
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            todo += [n for key in values if _related(key, name) for n in references[key]]
    groups = ("recipe", "experiment")  # their options set keys of other groups
    asked = [key for key in keys if key.partition(".")[0] in BY_REFERENCE and key not in groups]
    return [key for key in asked if not any(_related(key, name) for name in found)]


def _related(one: str, other: str) -> bool:
    """Return whether a dotted key equals, contains or is part of another."""
    return f"{one}.".startswith(f"{other}.") or f"{other}.".startswith(f"{one}.")


def require_referenced(jobs: Iterable[DictConfig], texts: Iterable[str]) -> None:
    """Raise UserError for an override without effect in every one of several configurations."""
    keys = keys_of(texts)
    for cfg in jobs:
        keys = unreferenced(cfg, keys)
    if keys:
        raise without_effect(keys[0], "no chosen option uses it")


def without_effect(key: str, reason: str) -> UserError:
    """Return the error for a key without effect."""
    message = f"{key}: expected a key with an effect; received one without: {reason}. Leave it out"
    return UserError(message)
