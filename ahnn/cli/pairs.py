"""The grammar of commands that compose no training: KEY=VALUE, quoted as in Hydra, and paths beside them."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import TypeVar

from ahnn.arguments import check_arguments
from ahnn.cli.commandline import pair
from ahnn.errors import UserError

T = TypeVar("T")


def read_pairs(arguments: list[str], schema: type[T], usage: str) -> T:
    """Return what a command line asks for.

    Args:
        arguments: KEY=VALUE, lists in brackets.
        schema: a dataclass.
        usage: for the message when nothing is given.

    Raises:
        UserError: no KEY=VALUE, a key that is unknown or missing, or a value of another type.
    """
    if not arguments:
        message = f"{usage}; received nothing"
        raise UserError(message)
    values = dict(map(pair, arguments))
    check_arguments("", schema, values)
    return schema(**values)


def divided(arguments: Iterable[str], keys: Collection[str] = ()) -> tuple[list[Path], list[str]]:
    """Return the paths of a command line, and its KEY=VALUE; a path with that sign in it is one that exists.

    Args:
        arguments: in any order.
        keys: that name no path, whatever exists.
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
