"""Keys of a command line in nodes that serve others: one that nothing refers to is refused, not dropped."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import flatten
from ahnn.errors import UserError

BY_REFERENCE = ("recipe", "experiment", "measurement", "integrator", "model_label")
"""Nodes of which nothing is built: other keys take their values from them."""
REFERENCE = re.compile(r"\$\{(?:oc\.select:)?([\w.]+)")


def keys_of(texts: Iterable[str]) -> list[str]:
    """Return the keys, and the groups, that overrides set; an option of a group may be put elsewhere, `@`."""
    pairs = (text.partition("=") for text in texts if not text.startswith("~"))  # these take keys away
    return [key.lstrip("+").rpartition("@")[2] for key, equals, _ in pairs if equals]


def unreferenced(cfg: DictConfig, keys: Iterable[str]) -> list[str]:
    """Return which of some keys lie in a node that serves others, none of which refers to them."""
    values: dict[str, Any] = flatten(OmegaConf.to_container(cfg, resolve=False))  # pyright: ignore[reportArgumentType]
    references, found = {key: REFERENCE.findall(str(value)) for key, value in values.items()}, set[str]()
    todo = [name for key in values if key.partition(".")[0] not in BY_REFERENCE for name in references[key]]
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            todo += [n for key in values if _related(key, name) for n in references[key]]
    groups = ("recipe", "experiment")  # an option of these sets keys of others
    asked = [key for key in keys if key.partition(".")[0] in BY_REFERENCE and key not in groups]
    return [key for key in asked if not any(_related(key, name) for name in found)]


def _related(one: str, other: str) -> bool:
    """Return whether a dotted key is another one, or in it, or around it."""
    return f"{one}.".startswith(f"{other}.") or f"{other}.".startswith(f"{one}.")


def require_referenced(jobs: Iterable[DictConfig], texts: Iterable[str]) -> None:
    """Refuse overrides that serve nothing in any of several configurations; raises UserError."""
    keys = keys_of(texts)
    for cfg in jobs:
        keys = unreferenced(cfg, keys)
    if keys:
        raise without_effect(keys[0], "nothing that was chosen takes it")


def without_effect(key: str, reason: str) -> UserError:
    """Return the refusal of a key."""
    message = f"{key}: expected a key with an effect; received one that has none: {reason}. Leave it out"
    return UserError(message)
