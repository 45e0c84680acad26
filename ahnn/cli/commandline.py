"""Composition of the command line before Hydra, so that every error gives one message.

Options and keys are read from the search path: this package's conf/, `--config-dir`, `hydra.searchpath` and
plugins that extend it, so that user-defined options are also found and suggested.
"""

from __future__ import annotations

import re
import shlex
from argparse import Namespace
from collections.abc import Iterable, Sequence
from inspect import signature
from itertools import islice
from pathlib import Path
from typing import Any, NoReturn

from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.utils import create_config_search_path, get_args_parser
from hydra.core.config_search_path import SearchPathQuery
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, IntervalSweep, Override, QuotedString, Sweep
from hydra.core.utils import setup_globals
from hydra.errors import HydraException, MissingConfigException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import flatten
from ahnn.cli.identical_jobs import warn_of_twins
from ahnn.cli.importing import let_import
from ahnn.cli.option_hints import nearest_key, once_each, unknown_option, unused_group
from ahnn.cli.preflight import require_folder_name, require_new
from ahnn.cli.recipe_checks import check_potential, check_recipe
from ahnn.cli.settings import CommonSettings
from ahnn.cli.sweep_syntax import sweep_fault
from ahnn.cli.sweep_values import check_swept_values
from ahnn.cli.trust import targets
from ahnn.cli.unreferenced_keys import require_referenced
from ahnn.errors import UserError
from ahnn.manifest import require_folder
from ahnn.paths import conf_dir

MODES = ("run", "multirun", "cfg", "info", "shell_completion")
VALUES = ("--cfg", "-c", "--package", "-p", "--config-dir", "-cd")
VALUES += ("--config-name", "-cn", "--config-path", "-cp")
INFOS = ("--info", "-i")
"""Flags of Hydra that take a value, and those that may take one."""
TEXTS = ("run", "pretrained", "ckpt", "weights", "name", "label", "start", "measurements", "state", "output")
TEXTS += ("figure", "figures", "oem", "object", "system.path", "system.name", "data.cache")
"""Keys whose values are names or paths."""
LISTS = ("run", "system.path")
"""Keys that accept several values."""
BARE = re.compile(r"\s*(true|false|[+-]?(inf|nan|(\d[\d_]*\.?\d*|\.\d+)(e[+-]?\d+)?))\s*", re.IGNORECASE)
"""Pattern of numbers and truth values in Hydra's grammar."""
SWEPT_INTO = "hydra.sweep.dir="
VALUED = re.compile(r"argument --(\w+)\S*: ignored explicit argument '(.*)'")
"""Pattern of argparse's message for a flag with a value."""


def read(argv: Sequence[str]) -> Namespace:
    """Parse the flags and overrides of a command line.

    Raises:
        UserError: an unknown flag, or incompatible flags.
    """
    parser = get_args_parser()
    parser.error = _refuse
    args = parser.parse_args(list(argv))
    modes = [f"--{name}" for name in MODES if getattr(args, name)]
    if len(modes) > 1:
        message = f"expected one of {' and '.join(modes)}; received both. Leave one out"
        raise UserError(message)
    return args


def flags_last(arguments: Sequence[str]) -> list[str]:
    """Return the words of a command line with flags after KEY=VALUE words, as argparse requires."""
    flags = [
        word.startswith("-") or before in VALUES or (before in INFOS and "=" not in word)
        for before, word in zip(("", *arguments), arguments, strict=False)
    ]
    return [
        word for last in (False, True) for word, flag in zip(arguments, flags, strict=True) if flag is last
    ]


def _refuse(message: str) -> NoReturn:
    if flag := VALUED.fullmatch(message):
        message = f"--{flag[1]} takes no value; a setting has no dashes: {flag[1]}={flag[2]}"
    text = f"command line: {message}; see --help"
    raise UserError(text)


def worded(text: str) -> str:
    """Quote numbers in KEY=VALUE for keys with text values: a folder may be named 007."""
    key, _, value = text.partition("=")
    many = key in LISTS and value.startswith("[") and value.endswith("]")
    if key not in TEXTS or not (many or BARE.fullmatch(value)):
        return text
    words = value[1:-1].split(",") if many else [value]
    quoted = ",".join(f"'{word.strip()}'" if BARE.fullmatch(word) else word for word in words)
    return f"{key}=[{quoted}]" if many else f"{key}={quoted}"


def in_one_folder(arguments: Sequence[str]) -> list[str]:
    """Let run=DIR of a sweep name the folder of all its jobs, which is Hydra's hydra.sweep.dir."""
    if not {"-m", "--multirun"} & {*arguments} or any(text.startswith(SWEPT_INTO) for text in arguments):
        return [*arguments]
    plain = re.compile(r"run=[^,(${]+")
    return [SWEPT_INTO + text[4:] if plain.fullmatch(text) else text for text in arguments]


def parse(text: str) -> Override:
    """Parse an override.

    Raises:
        UserError: invalid syntax; the message shows how to quote the value, or to write a sweep.
    """
    key, equals, value = text.partition("=")
    message = f"{text!r}: expected KEY=VALUE, for example seed=7"
    try:
        override = OverridesParser.create().parse_override(text)
    except HydraException as error:
        if fault := sweep_fault(text):
            raise UserError(fault) from error
        if value.startswith("[") and value.endswith(","):
            example = shlex.quote(f"{key}=[1.0, 2.0]")
            message = f"{text!r}: expected a closed list, but the shell splits at blanks. Quote it: {example}"
        elif equals and key:
            escaped = value.replace("\\", "\\\\").replace('"', '\\"')
            quoted = shlex.quote(f'{key}="{escaped}"')
            message = f"{text!r}: special characters in a value need quotes. Type {quoted}"
        raise UserError(message) from error
    if not override.key_or_group:
        raise UserError(message)
    if isinstance(override.value(), str | QuotedString) and (fault := sweep_fault(text)):
        raise UserError(fault)
    return override


def pair(text: str) -> tuple[str, Any]:
    """Return key and plain value of KEY=VALUE.

    Raises:
        UserError: other syntax, such as a sweep over several values.
    """
    override = parse(worded(text))
    if override.is_sweep_override() or override.get_key_element() != override.key_or_group:
        message = f"{text!r}: expected key=value with one value"
        raise UserError(message)
    return override.key_or_group, override.value()


def config_loader(folder: str | None = None) -> ConfigLoaderImpl:
    """Return Hydra's loader for the search path, preceded by a user folder if given.

    Raises:
        UserError: `folder` is not a folder.
    """
    setup_globals()
    path = create_config_search_path(str(conf_dir()))
    if folder is not None:
        if not Path(folder).is_dir():
            message = f"--config-dir: expected a folder; received {folder!r}"
            raise UserError(message)
        place = f"file://{Path(folder).resolve()}"
        path.prepend("command-line", place, SearchPathQuery(provider="schema"))
    return ConfigLoaderImpl(path)


def check(args: Namespace, config_name: str) -> DictConfig | None:
    """Compose jobs of a command line: each swept group option with the first option of all other groups.

    Returns the configuration of the first job, or None without a job.

    Raises:
        UserError: an unknown option or key, incompatible options or two of a group, a sweep without -m, or
            one into a foreign folder.
    """
    if args.config_path or args.experimental_rerun or args.shell_completion:
        return None
    loader, name = config_loader(args.config_dir), args.config_name or config_name
    overrides = once_each(loader, map(parse, args.overrides))
    values = [alternatives(o, loader) for o in overrides]
    sweeps = args.multirun or any(o.key_or_group == "hydra.mode" for o in overrides)
    if several := [o for o in overrides if o.is_sweep_override() and not sweeps]:
        message = f"{several[0].input_line!r}: expected one value; received several. Add -m to run them all"
        raise UserError(message)
    first = [options[0] for options in values]
    others = ((place, option) for place, options in enumerate(values) for option in options[1:])
    jobs = (first, *([*first[:place], option, *first[place + 1 :]] for place, option in others))
    composed = [compose(loader, name, job) for job in jobs]
    require_folder_name(composed[0])
    check_swept_values(overrides)
    if args.multirun:
        folder = Path(composed[0].hydra.sweep.dir)
        if "run" in {override.key_or_group for override in overrides} and folder != Path(composed[0].run):
            message = (
                "run: expected one folder for all jobs of a sweep, whose own folders are 0, 1, ... in it; "
                f"received {' '.join(args.overrides)}. Use run=DIR or hydra.sweep.dir=DIR"
            )
            raise UserError(message)
        require_folder(folder, "hydra.sweep.dir", [folder / "multirun.yaml"])
        if composed[0].hydra.sweeper._target_.endswith("BasicSweeper"):  # which writes multirun.yaml at once
            require_new(folder / "0", composed[0].get("ckpt"))
    require_referenced(composed, args.overrides)
    warn_of_twins(composed, [" ".join(job) for job in jobs])
    return composed[0]


def alternatives(override: Override, loader: ConfigLoaderImpl) -> list[str]:
    """Return an override for each named option of a group, or for the first value of a key.

    Raises:
        UserError: an unknown option of a group.
    """
    group, value, key = override.key_or_group, override.value(), override.get_key_element()
    is_group = loader.repository.group_exists(group)
    names = value.list if isinstance(value, ChoiceSweep) else value if isinstance(value, list) else [value]
    plain = all(isinstance(name, str | QuotedString | Sweep) for name in names)
    if is_group and not plain and not override.is_delete():
        options = ", ".join(loader.get_group_options(group))
        message = f"{group}: expected one of {options}; received {override.input_line!r}"
        raise UserError(message)
    if isinstance(value, IntervalSweep):
        return [f"{key}={value.start}"]
    if override.is_discrete_sweep():
        override.config_loader = loader
        return [f"{key}={text}" for text in islice(override.sweep_string_iterator(), None if is_group else 1)]
    return [str(override.input_line)]


def compose(loader: ConfigLoaderImpl, name: str, overrides: list[str]) -> DictConfig:
    """Return the configuration composed from overrides.

    Raises:
        UserError: an unknown option or key, or incompatible options.
    """
    try:
        cfg = loader.load_configuration(name, overrides, RunMode.RUN)
    except MissingConfigException as error:
        group, _, option = str(error.missing_cfg_file).rpartition("/")
        known = [one for one in error.options or loader.get_group_options(group) if one[0] != "_"]
        raise UserError(unknown_option(loader, group, option, known)) from error
    except HydraException as error:
        groups = [text for text in overrides if loader.repository.group_exists(text.partition("=")[0])]
        if groups == overrides:
            message = f"{' '.join(groups)}: these options are incompatible; {first_line(error)}"
            raise UserError(unused_group(first_line(error), groups) or message) from error
        plain: Any = OmegaConf.to_container(compose(loader, name, groups))
        message = f"configuration: {first_line(error)}"
        if key := getattr(error.__cause__, "full_key", None):
            asked = [str(override.key_or_group) for override in map(parse, overrides)]
            key = next((one for one in asked if one.startswith(f"{key}.")), key)  # the key up to the error
            hint = nearest_key(key, {*plain, *flatten(plain), *loader.list_groups("")})
            message = f"configuration: unknown key {key!r}{hint}"
        raise UserError(message) from error
    let_import(targets(OmegaConf.to_container(cfg)))
    check_additions(loader, overrides)
    check_recipe(cfg, overrides)
    check_potential(cfg, overrides)
    return cfg


def check_additions(loader: ConfigLoaderImpl, overrides: Iterable[str]) -> None:
    """Reject keys added at the top level, where nothing reads them; deeper ones are arguments of objects.

    Raises:
        UserError: such a key, unless another override refers to it.
    """
    for override in map(parse, overrides):
        key, text = override.key_or_group, str(override.input_line)
        read = (
            "." in key or key in signature(CommonSettings).parameters or loader.repository.group_exists(key)
        )
        if text.startswith("+") and not read and not any(f"${{{key}" in other for other in overrides):
            known = {*signature(CommonSettings).parameters, *loader.list_groups("")}
            message = f"{text!r}: expected a key that is used{nearest_key(key, known)}"
            raise UserError(message)


def first_line(error: BaseException) -> str:
    """Return the first line of an error, or of its cause."""
    source = error if str(error).strip() else (error.__cause__ or error.__context__ or error)
    lines = [line.strip() for line in str(source).splitlines() if line.strip()] or [type(source).__name__]
    return f"{lines[0]} {lines[1]}" if lines[0].endswith(":") and len(lines) > 1 else lines[0]
