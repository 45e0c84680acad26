"""Arguments from a configuration, checked against the signature of what they are for.

The signature is the schema: names, types and literals are written once, where they are used.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping
from difflib import get_close_matches
from pathlib import Path
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
    parameters = inspect.signature(target).parameters
    hints = type_hints(target)
    open_ended = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
    for name, value in arguments.items():
        if name not in parameters and not open_ended:
            message = f"{who}: unknown key {name!r}{nearest(name, parameters)}"
            raise UserError(message)
        hint = hints.get(name)
        default = value is None and name in parameters and parameters[name].default is None
        if hint is not None and not default and not fits(value, hint):
            message = f"{who}.{name}: expected {describe(hint)}; received {value!r} ({type(value).__name__})"
            raise UserError(message)


def check_names(
    who: str,
    target: Callable[..., Any],
    names: Collection[str],
    given: Collection[str] = (),
    *,
    partial: bool = False,
) -> None:
    """Check that the names of arguments are all that a class or function needs from a configuration.

    Args:
        who: name of the configuration node, for the message.
        target: what the arguments will be passed to.
        names: of the arguments that are in the configuration.
        given: of those that are not the user's to set.
        partial: whether the first argument follows later.

    Raises:
        UserError: a name that is unknown or not the user's, or one that is missing.
    """
    parameters = inspect.signature(target).parameters.values()
    open_ended = any(p.kind is p.VAR_KEYWORD for p in parameters)
    named = [p for p in parameters if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
    own = {p.name: p for p in named[int(partial) :] if p.name not in given}
    others = {p.name for p in named} - own.keys()
    for name in names:
        if name in others or (name not in own and not open_ended):
            message = f"{who}: unknown key {name!r}{nearest(name, own)}"
            raise UserError(message)
    for name, parameter in own.items():
        if parameter.default is parameter.empty and name not in names:
            message = f"{who}: expected key {name!r}; received {', '.join(names) or 'no key'}"
            raise UserError(message)


def type_hints(target: Callable[..., Any]) -> dict[str, Any]:
    """Return the annotations of a class's constructor or a function; none if they cannot be resolved."""
    try:
        return get_type_hints(target.__init__ if inspect.isclass(target) else target)
    except (NameError, TypeError):  # other libraries import some names for type checkers alone
        return {}


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
    if origin in (list, tuple) or hint in (list, tuple):
        if not isinstance(value, list | tuple) or not inner:
            return isinstance(value, list | tuple)
        items = inner[:1] * len(value) if repeats(hint) else inner
        return len(value) == len(items) and all(map(fits, value, items))
    if origin is dict or hint is dict:
        return isinstance(value, Mapping)
    plain = isinstance(value, str | int | float | list | dict | None)
    if not inspect.isclass(hint) or hint is Any or not plain:
        return True
    if hint is Path:
        return isinstance(value, str)
    return hint.__module__ in ("builtins", "collections.abc", "numbers") and isinstance(value, hint)


def repeats(hint: Any) -> bool:
    """Return whether the annotation of a list or tuple holds for any length."""
    return get_origin(hint) is not tuple or get_args(hint)[1:] == (...,)


def describe(hint: Any) -> str:
    """Return an annotation in words a user reads: `int`, `one of a, b`, `float or None`."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Literal:
        return "one of " + ", ".join(str(option) for option in inner)
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(describe(option) for option in inner))
    if origin in (list, tuple):
        return f"a list of {'' if repeats(hint) else f'{len(inner)} '}{describe(inner[0])}"
    return "None" if hint is NoneType else getattr(hint, "__name__", str(hint))
