"""Grammar of commands other than training: KEY=VALUE, quoted as in Hydra, and paths."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from inspect import signature
from pathlib import Path
from typing import Any, TypeVar

from ahnn.arguments import check_arguments, nearest
from ahnn.cli.commandline import pair
from ahnn.errors import UserError, WrongUsage

T = TypeVar("T")


def read_pairs(arguments: list[str], schema: type[T]) -> T:
    """Parse a command line.

    Args:
        arguments: KEY=VALUE, lists in brackets.
        schema: dataclass of the keys.

    Raises:
        WrongUsage: an empty command line.
        UserError: invalid syntax, an unknown or missing key, or a value of the wrong type.
    """
    if not arguments:
        message = "received nothing"
        raise WrongUsage(message)
    values = dict(map(pair, arguments))
    require_known(values, signature(schema).parameters)
    check_arguments("", schema, values)
    return schema(**values)


def require_known(given: Iterable[str], known: Collection[str]) -> None:
    """Raise UserError for a key that a command does not have."""
    if unknown := [key for key in given if key not in known]:
        message = f"unknown key {unknown[0]!r}{nearest(unknown[0], known, '; --help lists the keys')}"
        raise UserError(message)


def require_input(options: Mapping[str, Any], given: Iterable[str]) -> None:
    """Raise UserError for a stream without measurements.

    Args:
        options: values of the keys of the stream.
        given: command line, in which `measurement=` may have been meant as `measurements=`.
    """
    if options["measurements"] is None:
        chosen = any(text.startswith("measurement=") for text in given)
        hint = "; measurement= chooses the sensor" if chosen else ""
        message = (
            "measurements: expected a file of measurements, or - for standard input; received none. Add "
            f"measurements=FILE{hint}"
        )
        raise UserError(message)


def divided(arguments: Iterable[str], keys: Collection[str] = ()) -> tuple[list[Path], list[str]]:
    """Split a command line into paths and KEY=VALUE; a path may contain = if it exists.

    Args:
        arguments: arguments in any order.
        keys: keys that are never treated as paths.
    """
    paths, pairs = [], []
    for text in arguments:
        key, sign, _ = text.partition("=")
        path = Path(text).expanduser()
        if sign and (key in keys or not path.exists()):
            pairs.append(text)
        else:
            paths.append(path)
    return paths, pairs
