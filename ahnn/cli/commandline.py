"""The command line, compared with what can be chosen and set before Hydra sees it.

Options and keys are those of the search path: this package's conf/, `--config-dir`, `hydra.searchpath` and
the plugins that extend it, so that options of one's own are found and offered too.
"""

from __future__ import annotations

import shlex
from argparse import Namespace
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NoReturn

from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.utils import create_config_search_path, get_args_parser
from hydra.core.config_search_path import SearchPathQuery
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, Override, QuotedString
from hydra.core.utils import setup_globals
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import nearest
from ahnn.errors import UserError
from ahnn.paths import conf_dir

MODES = ("run", "multirun", "cfg", "info", "shell_completion")


def read(argv: Sequence[str]) -> Namespace:
    """Return the flags and overrides of a command line.

    Raises:
        UserError: an unknown flag, or flags that do not go together.
    """
    parser = get_args_parser()
    parser.error = _refuse
    args = parser.parse_args(list(argv))
    modes = [f"--{name}" for name in MODES if getattr(args, name)]
    if len(modes) > 1:
        message = f"expected one of {' and '.join(modes)}; received both. Leave one out"
        raise UserError(message)
    return args


def _refuse(message: str) -> NoReturn:
    text = f"command line: {message}; --help shows what there is"
    raise UserError(text)


def parse(text: str) -> Override:
    """Return an override.

    Raises:
        UserError: it is not written as one; the message shows how to quote its value.
    """
    key, equals, value = text.partition("=")
    try:
        return OverridesParser.create().parse_override(text)
    except HydraException as error:
        message = f"{text!r}: expected KEY=VALUE, for example seed=7"
        if equals and key:
            escaped = value.replace("\\", "\\\\").replace('"', '\\"')
            quoted = shlex.quote(f'{key}="{escaped}"')
            message = f"{text!r}: special characters in a value need quotes. Type {quoted}"
        raise UserError(message) from error


def config_loader(args: Namespace, overrides: Iterable[Override] = ()) -> ConfigLoaderImpl:
    """Return Hydra's loader over the search path of a command line.

    Raises:
        UserError: `--config-dir` names no folder.
    """
    setup_globals()
    path = create_config_search_path(str(conf_dir()))
    places: list[str] = []
    if args.config_dir is not None:
        if not Path(args.config_dir).is_dir():
            message = f"--config-dir: expected a folder; received {args.config_dir!r}"
            raise UserError(message)
        places.append(f"file://{Path(args.config_dir).resolve()}")
    for override in overrides:
        if override.get_key_element() == "hydra.searchpath" and isinstance(override.value(), list):
            places += map(str, override.value())  # pyright: ignore[reportArgumentType]
    for place in places:
        path.prepend("command-line", place, SearchPathQuery(provider="schema"))
    return ConfigLoaderImpl(path)


def check(args: Namespace, config_name: str) -> None:
    """Compare every override of a command line with the groups, options and keys that there are.

    Raises:
        UserError: an option or key that is unknown, options that do not go together, or a sweep without -m.
    """
    if args.config_path or args.experimental_rerun or args.shell_completion:
        return
    overrides = [parse(text) for text in args.overrides]
    loader = config_loader(args, overrides)
    sweeps = args.multirun or any(o.key_or_group == "hydra.mode" for o in overrides)
    chosen, swept, keys = [], [], []
    for override in overrides:
        if override.is_sweep_override() and not sweeps:
            message = f"{override.input_line!r}: expected one value; received several. Add -m to run them all"
            raise UserError(message)
        if not override.key_or_group:
            message = f"expected KEY=VALUE; received {override.input_line!r}"
            raise UserError(message)
        if override.is_delete() and "." not in override.key_or_group:
            message = f"{override.input_line}: every training needs {override.key_or_group}. Leave out the ~"
            raise UserError(message)
        if not loader.repository.group_exists(override.key_or_group):
            keys.append(override)
            continue
        texts = _choices(override, loader)
        (swept if len(texts) > 1 else chosen).append(texts)
    first = [texts[0] for texts in (*chosen, *swept) if texts]
    name = args.config_name or config_name
    known: set[str] = set()
    for alternative in [[], *([text] for texts in swept for text in texts[1:])]:
        known |= {*dotted_keys(_compose(loader, name, [*first, *alternative]))}
    for override in keys:
        _check_key(override, known, loader.list_groups(""))


def _choices(override: Override, loader: ConfigLoaderImpl) -> list[str]:
    """Return what is chosen of a group, a sweep as several overrides; none where it cannot be told."""
    group, value = override.key_or_group, override.value()
    if override.is_delete() or (override.is_sweep_override() and not isinstance(value, ChoiceSweep)):
        return []
    options = loader.get_group_options(group)
    names = value.list if isinstance(value, ChoiceSweep) else [value]
    for name in (n for item in names for n in (item if isinstance(item, list) else [item])):
        plain = name.text if isinstance(name, QuotedString) else name
        if not isinstance(plain, str):
            message = f"{group}: expected one of {', '.join(options)}; received {override.input_line!r}"
            raise UserError(message)
        if plain not in options and not loader.repository.config_exists(f"{group}/{plain}"):
            message = f"{group}: unknown option {plain!r}{nearest(plain, options)}"
            raise UserError(message)
    if not isinstance(value, ChoiceSweep):
        return [str(override.input_line)]
    return [f"{override.get_key_element()}={str(name).replace(chr(39), '')}" for name in names]


def _compose(loader: ConfigLoaderImpl, name: str, chosen: list[str]) -> DictConfig:
    """Return the configuration of the chosen options.

    Raises:
        UserError: they do not go together.
    """
    try:
        return loader.load_configuration(name, chosen, RunMode.RUN)
    except HydraException as error:
        for text in chosen:
            group = text.partition("=")[0]
            others = [other for other in chosen if other != text]
            if group in _groups_of(loader, name, others):
                continue
            beside = " ".join(others) or "the defaults"
            message = f"{group}: expected options that have a {group}; received {beside}. Leave out {text}"
            raise UserError(message) from error
        message = f"{' '.join(chosen)}: these options do not go together; {first_line(error).split('. ')[0]}"
        raise UserError(message) from error


def _groups_of(loader: ConfigLoaderImpl, name: str, chosen: list[str]) -> set[str]:
    try:
        cfg = loader.load_configuration(name, chosen, RunMode.RUN)
    except HydraException:
        return set(loader.list_groups(""))
    return {str(key).partition("@")[0] for key in (*cfg.hydra.runtime.choices, "callbacks")}


def _check_key(override: Override, known: set[str], groups: Sequence[str]) -> None:
    key = override.key_or_group
    if override.is_add() and key in known:
        message = f"{override.input_line}: expected a new key; {key} is there already. Leave out the +"
        raise UserError(message)
    if override.is_add() or override.is_force_add() or override.package is not None or key in known:
        return
    message = f"configuration: unknown key {key!r}{nearest_key(key, {*known, *groups})}"
    raise UserError(message)


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


def dotted_keys(cfg: Any, prefix: str = "") -> Iterable[str]:
    """Yield every key of a nested configuration, dotted; places of a list count as keys."""
    content = OmegaConf.to_container(cfg, resolve=False) if OmegaConf.is_config(cfg) else cfg
    items = content.items() if isinstance(content, dict) else enumerate(content)  # pyright: ignore
    for name, value in items:
        yield f"{prefix}{name}"
        if isinstance(value, dict | list):
            yield from dotted_keys(value, f"{prefix}{name}.")


def first_line(error: BaseException) -> str:
    """Return the first line of an error, or of what it came from."""
    source = error if str(error).strip() else (error.__cause__ or error.__context__ or error)
    lines = [line.strip() for line in str(source).splitlines() if line.strip()] or [type(source).__name__]
    return f"{lines[0]} {lines[1]}" if lines[0].endswith(":") and len(lines) > 1 else lines[0]
