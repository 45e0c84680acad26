"""Messages on options of groups: unknown ones, and groups named twice."""

from __future__ import annotations

from collections.abc import Iterable

from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.override_parser.types import Override

from ahnn.arguments import nearest
from ahnn.errors import UserError

OWN = ". For your own options add --config-dir FOLDER"


def unknown_option(loader: ConfigLoaderImpl, group: str, option: str, known: Iterable[str]) -> str:
    """Return the message on an unknown option, with a group that has it, or with the nearest one."""
    others = [one for one in loader.list_groups("") if option in loader.get_group_options(one)]
    if group and others:
        return f"{group}: unknown option {option!r}; it is an option of {others[0]}: {others[0]}={option}"
    hint = nearest(option, known)
    return f"{group or '--config-name'}: unknown option {option!r}{hint}{OWN * ('it takes' in hint)}"


def once_each(loader: ConfigLoaderImpl, overrides: Iterable[Override]) -> list[Override]:
    """Return overrides; raise UserError for two options of a group, of which Hydra would take the last."""
    named, found = dict[str, str](), [*overrides]
    for override in found:
        key, text = override.get_key_element(), str(override.input_line)
        if loader.repository.group_exists(override.key_or_group) and named.setdefault(key, text) != text:
            message = f"{key}: expected one option; received {named[key]} and {text}. Leave one out"
            raise UserError(message)
    return found
