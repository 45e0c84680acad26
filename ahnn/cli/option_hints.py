"""Messages on options of groups, unknown or named twice, and on unknown keys."""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches

from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.override_parser.types import Override

from ahnn.arguments import nearest
from ahnn.errors import UserError

RATE = "optimizer.lr"
RATES = ("lr", "learning_rate", RATE, "optimizer.learning_rate", "optimiser.lr", "optimiser.learning_rate")
"""Names by which users may refer to the learning rate."""
NEAR = 0.65
"""Similarity from which the last part of another key is suggested."""
ABSENT = re.compile(r"Could not override '(\w+)'\. No match in the defaults list")
OWN = ". For your own options add --config-dir FOLDER"


def unknown_option(loader: ConfigLoaderImpl, group: str, option: str, known: Iterable[str]) -> str:
    """Return the message on an unknown option, with a group that has it, or with the nearest one."""
    others = [one for one in loader.list_groups("") if option in loader.get_group_options(one)]
    if group and others:
        return f"{group}: unknown option {option!r}; it is an option of {others[0]}: {others[0]}={option}"
    hint = nearest(option, known)
    return f"{group or '--config-name'}: unknown option {option!r}{hint}{OWN * ('it takes' in hint)}"


def unused_group(said: str, overrides: Iterable[str]) -> str | None:
    """Return the message on an option whose group the chosen model has not; None for other errors of Hydra.

    Args:
        said: first line of the error.
        overrides: options of groups on the command line.
    """
    if (found := ABSENT.search(said)) is None:
        return None
    group, given = found[1], {text.partition("=")[0]: text for text in overrides}
    if group not in given:
        return None
    part = "a Hamiltonian" if group == "hamiltonian" else f"options of {group}"
    received = f"{given.get('model', 'one')}, which has none"
    return (
        f"{given[group]}: expected a model with {part}; received {received}. Use model=ahnn, or leave "
        f"{given[group]} out"
    )


def once_each(loader: ConfigLoaderImpl, overrides: Iterable[Override]) -> list[Override]:
    """Return overrides; raise UserError for two options of a group, of which Hydra would take the last."""
    named, found = dict[str, str](), [*overrides]
    for override in found:
        key, text = override.get_key_element(), str(override.input_line)
        if loader.repository.group_exists(override.key_or_group) and named.setdefault(key, text) != text:
            message = f"{key}: expected one option; received {named[key]} and {text}. Leave one out"
            raise UserError(message)
    return found


def nearest_key(wrong: str, known: Iterable[str]) -> str:
    """Return a hint with the dotted key that is closest to a wrong key, in full or in its last part.

    Without a close match the hint lists the keys beside the wrong one: all keys fill several pages.
    """
    known = sorted(known)
    last = wrong.rpartition(".")[2]
    if wrong in RATES and RATE not in known:
        return f"; this optimiser has no learning rate. Use recipe=first_order {RATE}=VALUE"
    if wrong in RATES:
        return f"; did you mean {RATE!r}?"
    parts = {key.rpartition(".")[2] for key in known if not key.startswith("hydra.")}
    for close in (
        [last],
        get_close_matches(wrong, known, n=1, cutoff=0.7),
        get_close_matches(last, parts, cutoff=NEAR),
    ):
        same = [key for key in known if key in close or key.rpartition(".")[2] in close]
        if same:
            return f"; did you mean {get_close_matches(wrong, same, n=1, cutoff=0)[0]!r}?"
    group = wrong.rpartition(".")[0]
    beside = [key.removeprefix(f"{group}.") for key in known if key.startswith(f"{group}.")]
    if "_target_" in beside:
        beside.remove("_target_")
        return f"; {group} takes {', '.join(beside)}. Pass another argument as +{wrong}=VALUE"
    return nearest(wrong, [key for key in known if "." not in key])
