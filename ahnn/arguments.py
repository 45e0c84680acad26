"""Arguments checked against the signature of what they are for, from a configuration and from Python alike.

The signature is the schema: names, types, literals and limits are written once, where they are used:

    @checked
    class Loader:
        def __init__(self, batch_size: Count, emphasis: Annotated[float, Within(0, 4)]) -> None: ...

Python reads `batch_size: expected int >= 1; received 0`, a user of YAML `data.batch_size: ...`.
"""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Collection, Mapping
from difflib import get_close_matches
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

from ahnn.errors import UserError

T = TypeVar("T", bound=type)


class Within(NamedTuple):
    """Limits of a number, both included; infinity and NaN are never within."""

    least: float = -math.inf
    most: float = math.inf

    def __contains__(self, value: Any) -> bool:
        return math.isfinite(value) and self.least <= value <= self.most

    def __str__(self) -> str:
        if self.most == math.inf:
            return f">= {self.least:g}"
        return f"from {self.least} to {self.most}"


Count = Annotated[int, Within(1)]
Seed = Annotated[int, Within(0, 2**32 - 1)]


def checked(cls: T) -> T:
    """Let a class refuse wrong arguments by the annotations of its constructor, before it runs.

    The constructor then raises UserError: a value of another type or beyond its limits.
    """
    init = cls.__init__
    signature = inspect.signature(init)

    @functools.wraps(init)
    def __init__(self: Any, *args: Any, **kwargs: Any) -> None:
        named = dict(list(signature.bind(self, *args, **kwargs).arguments.items())[1:])
        kinds = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
        plain = {k: v for k, v in named.items() if signature.parameters[k].kind not in kinds}
        check_arguments("", cls, plain)
        init(self, *args, **kwargs)

    cls.__init__ = __init__
    return cls


def check_arguments(who: str, target: Callable[..., Any], arguments: Mapping[str, Any]) -> None:
    """Compare keyword arguments with the annotations of a class or function.

    Args:
        who: name of the configuration node, for the message; "" names the argument alone.
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
            message = f"{who}: unknown key {name!r}{nearest(name, parameters)}".removeprefix(": ")
            raise UserError(message)
        hint = hints.get(name)
        default = value is None and name in parameters and parameters[name].default is None
        if hint is not None and not default and not fits(value, hint):
            kind = "" if fits(value, bare(hint)) else f" ({type(value).__name__})"
            message = f"{who}.{name}: expected {describe(hint)}; received {value!r}{kind}".removeprefix(".")
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
            message = f"{who}: unknown key {name!r}{nearest(name, own)}".removeprefix(": ")
            raise UserError(message)
    for name, parameter in own.items():
        if parameter.default is parameter.empty and name not in names:
            message = f"{who}: expected key {name!r}; received {', '.join(names) or 'no key'}".removeprefix(
                ": "
            )
            raise UserError(message)


def type_hints(target: Callable[..., Any]) -> dict[str, Any]:
    """Return the annotations of a class's constructor or a function; none if they cannot be resolved."""
    try:
        return get_type_hints(target.__init__ if inspect.isclass(target) else target, include_extras=True)
    except (NameError, TypeError):  # other libraries import some names for type checkers alone
        return {}


def flatten(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested plain values under dotted keys; lists and tuples compare alike."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = list(value) if isinstance(value, tuple) else value
    return flat


def nearest(name: str, known: Any) -> str:
    """Return '; did you mean ...?' with the closest known name, or the list of names."""
    names = [str(k) for k in known]
    close = get_close_matches(name, names, n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else f"; it takes {', '.join(names)}"


def fits(value: Any, hint: Any) -> bool:
    """Return whether a plain value is of an annotated type; types other than plain ones always fit."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        limits = [limit for limit in inner[1:] if isinstance(limit, Within)]
        return fits(value, inner[0]) and all(value in limit for limit in limits)
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


def bare(hint: Any) -> Any:
    """Return an annotation without its limits."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return inner[0]
    if origin in (Union, UnionType):
        return Union[tuple(bare(option) for option in inner)]  # noqa: UP007
    return hint


def repeats(hint: Any) -> bool:
    """Return whether the annotation of a list or tuple holds for any length."""
    return get_origin(hint) is not tuple or get_args(hint)[1:] == (...,)


def describe(hint: Any) -> str:
    """Return an annotation in words a user reads: `int`, `one of a, b`, `float or None`."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return " ".join([describe(inner[0]), *(str(limit) for limit in inner[1:])])
    if origin is Literal:
        return ("one of " if inner[1:] else "") + ", ".join(str(option) for option in inner)
    if origin in (Union, UnionType):
        names = {describe(option) for option in inner}  # the order of a union is that of whoever came first
        return " or ".join(sorted(names, key=lambda name: (name == "None", name.lower())))
    if origin in (list, tuple):
        return f"a list of {'' if repeats(hint) else f'{len(inner)} '}{describe(inner[0])}"
    return "None" if hint is NoneType else getattr(hint, "__name__", str(hint))
