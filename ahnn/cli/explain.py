"""What Hydra and OmegaConf say of a mistake, in one message with the nearest valid name."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from ahnn.arguments import nearest
from ahnn.paths import conf_dir

NO_OPTION = "Config group override must be a string or a list"
"""How Hydra's ValueError for `system=null` begins."""


def explain(error: Exception) -> str:
    """Return a configuration error of Hydra or OmegaConf as one message with the nearest valid name."""
    source = error if str(error).strip() else (error.__cause__ or error.__context__ or error)
    lines = [line for line in str(source).splitlines() if line.strip()]
    text = lines[0] if lines else type(source).__name__
    if text.startswith(NO_OPTION):
        return no_option()
    if text.endswith(":") and len(lines) > 1:  # Hydra names the target first, and what it said below
        text = f"{text} {lines[1]}"
    full_key = error.full_key if isinstance(error, OmegaConfBaseException) else None
    wrong = re.search(r"Could not override '([\w.@]+)'|Key '([\w.]+)'|key '([\w.]+)' not found", text)
    if wrong:
        key = next(name for name in wrong.groups() if name)
        return unknown_key(str(full_key) if full_key and str(full_key).endswith(f".{key}") else key)
    missing = re.search(r"Could not find '([\w/]+)/([\w.-]+)'", text)
    if missing:
        options = [line.strip() for line in lines[2:] if line.startswith("\t")]
        return f"configuration: {missing[1]}: unknown option {missing[2]!r}{nearest(missing[2], options)}"
    return f"configuration: {text}{f' ({full_key})' if full_key else ''}"


def unknown_key(wrong: str) -> str:
    """Return the message on a key that is not there: the nearest one, or that it was taken away."""
    cfg = chosen_config()
    known = {*dotted_keys(cfg), *groups()}
    if wrong in known:
        return f"configuration: expected key {wrong!r}; received none. Leave away the ~ that removes it"
    return f"configuration: unknown key {wrong!r}{nearest_key(wrong, known)}"


def nearest_key(wrong: str, known: Iterable[str]) -> str:
    """Return a hint with the dotted key that is closest to a wrong one, as a whole or in its last part.

    Without any that is close, the hint lists the top level alone: all keys are several pages.
    """
    known = sorted(known)
    last = wrong.rpartition(".")[2]
    parts = {key.rpartition(".")[2] for key in known if not key.startswith("hydra.")}
    for close in ([last], get_close_matches(wrong, known, n=1, cutoff=0.7), get_close_matches(last, parts)):
        same = [key for key in known if key in close or key.rpartition(".")[2] in close]
        if same:
            return f"; did you mean {get_close_matches(wrong, same, n=1, cutoff=0)[0]!r}?"
    return nearest(wrong, [key for key in known if "." not in key])


def no_option() -> str:
    """Return the message on a group that is given something else than the name of an option."""
    for override in typed_overrides():
        if isinstance(override.value(), str | list) or override.is_delete():
            continue
        group, text = override.key_or_group, override.input_line
        if group in groups():
            options = sorted(path.stem for path in (conf_dir() / group).glob("*.yaml"))
            return f"configuration: {group}: expected one of {', '.join(options)}; received {text!r}"
        if not group:
            return f"configuration: expected key=value; received {text!r}"
    return "configuration: expected the name of an option for every group; received another value"


def groups() -> list[str]:
    """Return the names of the config groups, nested ones apart."""
    return sorted(folder.name for folder in conf_dir().iterdir() if folder.is_dir())


def typed_overrides() -> list[Override]:
    """Return the overrides of this command line; none if they cannot be read."""
    try:
        return OverridesParser.create().parse_overrides([a for a in sys.argv[1:] if "=" in a])
    except HydraException:
        return []


def chosen_config() -> DictConfig:
    """Return the configuration of the options that this command line chooses, or of the defaults."""
    GlobalHydra.instance().clear()
    chosen = [str(o.input_line) for o in typed_overrides() if o.key_or_group in groups()]
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        try:
            return compose("train", chosen)
        except (HydraException, OmegaConfBaseException, ValueError):  # a sweep over options, a wrong one
            return compose("train")


def dotted_keys(cfg: Any, prefix: str = "") -> Iterable[str]:
    """Yield every key of a nested configuration, dotted."""
    for key, value in OmegaConf.to_container(cfg, resolve=False).items():  # pyright: ignore
        yield f"{prefix}{key}"
        if isinstance(value, dict):
            yield from dotted_keys(OmegaConf.create(value), f"{prefix}{key}.")
