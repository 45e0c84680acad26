"""Commands that take KEY=VALUE alone: the keys are the fields of a dataclass, checked by its annotations."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from ahnn.arguments import check_arguments
from ahnn.cli.commandline import pair
from ahnn.errors import UserError

if TYPE_CHECKING:
    from ahnn.runs import Run

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


def named_runs(run: str | list[str] | None, pretrained: str | None, ckpt: str) -> list[Run]:
    """Return the runs, or the shipped model, that a command names.

    Raises:
        UserError: neither or both are named, there is no such run, or their states differ.
    """
    from ahnn.pretrained import shipped
    from ahnn.runs import load

    if (not run and pretrained is None) or (run and pretrained is not None):
        message = f"run: expected run=DIR or pretrained=NAME; received {'both' if run else 'neither'}"
        raise UserError(message)
    folders = [shipped(pretrained)] if pretrained is not None else run if isinstance(run, list) else [run]
    runs = [load(str(folder), ckpt) for folder in folders]
    first = runs[0].space._replace(name="")
    for other in runs[1:]:
        if (space := other.space._replace(name="")) != first:
            message = f"run: expected runs of the same states and units; received {first} and {space}"
            raise UserError(message)
    return runs
