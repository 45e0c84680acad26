"""Arguments from a configuration, checked against the signature of what they are for.

The signature is the schema: names, types and literals are written once, where they are used.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from ahnn.errors import UserError


def check_arguments(who: str, target: Callable[..., Any], arguments: Mapping[str, Any]) -> None:
    """Compare keyword arguments with the annotations of a class or function.

    Args:
        who: name of the configuration node, for the message.
        target: what the arguments will be passed to.
        arguments: plain values; objects that are built already pass unchecked.

    Raises:
        UserError: an unknown name or a value of another type.
    """
    function = target.__init__ if inspect.isclass(target) else target
    parameters = inspect.signature(target).parameters
    hints = get_type_hints(function)
    open_ended = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
    for name, value in arguments.items():
        if name not in parameters and not open_ended:
            message = f"{who}: unknown key {name!r}{nearest(name, parameters)}"
            raise UserError(message)
        hint = hints.get(name)
        if hint is not None and not fits(value, hint):
            message = f"{who}.{name}: expected {describe(hint)}; received {value!r} ({type(value).__name__})"
            raise UserError(message)


def nearest(name: str, known: Any) -> str:
    """Return '; did you mean ...?' with the closest known name, or the list of names."""
    names = [str(k) for k in known]
    close = get_close_matches(name, names, n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else f"; it takes {', '.join(names)}"


def fits(value: Any, hint: Any) -> bool:
    """Return whether a plain value is of an annotated type; types other than plain ones always fit."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Literal:
        return value in inner
    if origin in (Union, UnionType):
        return any(fits(value, option) for option in inner)
    if hint is NoneType:
        return value is None
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if hint in (str, bool):
        return isinstance(value, hint)
    if origin in (list, tuple):
        return isinstance(value, list | tuple) and all(fits(item, inner[0]) for item in value)
    if origin is dict or hint is dict:
        return isinstance(value, Mapping)
    return not isinstance(value, str | int | float | list | dict) if inspect.isclass(hint) else True


def describe(hint: Any) -> str:
    """Return an annotation in words a user reads: `int`, `one of a, b`, `float or None`."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Literal:
        return "one of " + ", ".join(str(option) for option in inner)
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(describe(option) for option in inner))
    if origin in (list, tuple):
        return f"a list of {describe(inner[0])}"
    return "None" if hint is NoneType else getattr(hint, "__name__", str(hint))
