"""Validation of arguments against the callee's signature, for configurations and Python calls alike.

The signature is the schema: names, types, literals and limits are written once, where they are used:

    @checked
    class Loader:
        def __init__(self, batch_size: Count, emphasis: Annotated[float, Within(0, 4)]) -> None: ...

The message is `batch_size: expected int >= 1; received 0` in Python, and `data.batch_size: ...` for YAML.
"""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import is_dataclass
from difflib import get_close_matches
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from ahnn.errors import UserError

T = TypeVar("T", bound=Callable[..., Any])

LONGEST = 300
"""Maximum number of characters of a value in a message."""


class Within(NamedTuple):
    """Limits of a number; infinity and NaN are always rejected.

    Attributes:
        least, most: inclusive limits.
        above, below: exclusive limits.
        multiple: required divisor; 0 accepts any number.
    """

    least: float = -math.inf
    most: float = math.inf
    above: float = -math.inf
    below: float = math.inf
    multiple: int = 0

    def __contains__(self, value: Any) -> bool:
        limited = self.least <= value <= self.most and self.above < value < self.below
        whole = self.multiple == 0 or value % self.multiple == 0
        return limited and whole and abs(value) < math.inf  # exact for integers of any size

    def __str__(self) -> str:
        if math.isfinite(self.least) and math.isfinite(self.most):
            return f"from {self.least} to {self.most}"
        signs = {">=": self.least, ">": self.above, "<=": self.most, "<": self.below}
        words = [f"{sign} {limit:g}" for sign, limit in signs.items() if math.isfinite(limit)]
        words += [f"a multiple of {self.multiple}"] if self.multiple else []
        return " and ".join(words) or "(finite)"


class Interval(NamedTuple):
    """Limits of both ends of a range [low, high], low <= high."""

    ends: Within = Within()

    def __contains__(self, value: Any) -> bool:
        return len(value) == 2 and value[0] <= value[1] and all(end in self.ends for end in value)

    def __str__(self) -> str:
        return f"a range [low, high] of numbers {self.ends}, with low <= high"


class Printable(NamedTuple):
    """Restriction of a text to printable characters, since terminals interpret control characters."""

    most: int = 200

    def __contains__(self, value: Any) -> bool:
        return len(value) <= self.most and value.isprintable()

    def __str__(self) -> str:
        return f"of at most {self.most} printable characters"


Count = Annotated[int, Within(1)]
Seed = Annotated[int, Within(0, 2**32 - 1)]
Text = Annotated[str, Printable()]
Finite = Annotated[float, Within()]
Positive = Annotated[float, Within(above=0)]
NonNegative = Annotated[float, Within(0)]
Range = Annotated[tuple[float, float] | list[float], Interval()]


def checked(target: T) -> T:
    """Make a class or function validate its arguments against its annotations before it runs.

    The decorated callable raises UserError for a value of the wrong type or outside its limits.
    """
    call = target.__init__ if inspect.isclass(target) else target
    signature, skipped = inspect.signature(call), int(inspect.isclass(target))

    @functools.wraps(call)
    def checked_call(*args: Any, **kwargs: Any) -> Any:
        named = list(signature.bind(*args, **kwargs).arguments.items())[skipped:]
        check_values("", target, dict(named))
        return call(*args, **kwargs)

    if not inspect.isclass(target):
        return cast(T, checked_call)
    target.__init__ = checked_call
    return cast(T, target)


def check_arguments(
    who: str,
    target: Callable[..., Any],
    arguments: Mapping[str, Any],
    given: Collection[str] = (),
    *,
    partial: bool = False,
) -> None:
    """Check that keyword arguments are complete for a class or function, and within their limits.

    Args:
        who: name of the configuration node, for the message; "": only the argument is named.
        target: class or function that will receive the arguments.
        arguments: plain values.
        given: names of arguments that the user may not set.
        partial: whether the first argument is supplied later.

    Raises:
        UserError: an argument that is unknown, missing or reserved, or a value of the wrong type.
    """
    parameters = inspect.signature(target).parameters.values()
    open_ended = any(p.kind is p.VAR_KEYWORD for p in parameters)
    named = [p for p in parameters if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
    own = {p.name: p for p in named[int(partial) :] if p.name not in given}
    others = {p.name for p in named} - own.keys()
    unknown = [n for n in arguments if n in others or (n not in own and not open_ended)]
    missing = [n for n, p in own.items() if p.default is p.empty and n not in arguments]
    if unknown:
        message = f"{who}: unknown key {unknown[0]!r}{nearest(unknown[0], own)}".removeprefix(": ")
        raise UserError(message)
    if missing:
        received = ", ".join(arguments) or "no key"
        message = f"{who}: expected key {missing[0]!r}; received {received}"
        message = message if who else f"{message.removeprefix(': ')}. Add {missing[0]}=VALUE"
        raise UserError(message)
    check_values(who, target, arguments)


def check_values(who: str, target: Callable[..., Any], arguments: Mapping[str, Any]) -> None:
    """Compare arguments with the annotations of a class or function.

    None is accepted where it is the default. Objects already built, and nodes yet to be built, are accepted.

    Raises:
        UserError: a value of the wrong type or outside its limits.
    """
    parameters, hints = inspect.signature(target).parameters, type_hints(target)
    for name, value in arguments.items():
        hint = hints.get(name)
        default = value is None and name in parameters and parameters[name].default is None
        later = isinstance(value, Mapping) and "_target_" in value
        if hint is not None and not default and not later and not fits(value, hint):
            kind = "" if fits(value, type_hints(target, limits=False)[name]) else f" ({type(value).__name__})"
            received = shown if len(shown := repr(value)) <= LONGEST else f"{shown[:LONGEST]}..."
            message = f"{who}.{name}: expected {describe(hint)}; received {received}{kind}".removeprefix(".")
            raise UserError(message)


def type_hints(target: Callable[..., Any], *, limits: bool = True) -> dict[str, Any]:
    """Return the annotations of a class's constructor or a function; empty if they cannot be resolved."""
    fields = is_dataclass(target) or hasattr(target, "_fields")
    source = target.__init__ if inspect.isclass(target) and not fields else target
    try:
        return get_type_hints(source, include_extras=limits)
    except (NameError, TypeError):  # other libraries import some names for type checkers only
        return {}


def flatten(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested plain values as a flat mapping with dotted keys; lists and tuples compare equal."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = list(value) if isinstance(value, tuple) else value
    return flat


def nearest(name: str, known: Any, otherwise: str | None = None) -> str:
    """Return '; did you mean ...?' with a known name that is close, else `otherwise` or the list of names.

    Two exchanged neighbours are one slip, so that a name differing by them alone comes first.
    """
    names = [str(k) for k in known]
    swapped = {name[:k] + name[k + 1] + name[k] + name[k + 2 :] for k in range(len(name) - 1)}
    close = [one for one in names if one in swapped] or get_close_matches(name, names, n=1)
    listed = f"; it takes {', '.join(names)}" if otherwise is None else otherwise
    return f"; did you mean {close[0]!r}?" if close else listed


PLAIN = {float: (int, float), int: int, str: str, bool: bool, NoneType: NoneType}
"""Python types accepted for each plain annotation; True and False are not numbers."""


def fits(value: Any, hint: Any) -> bool:
    """Return whether a plain value matches an annotated type; other annotations always match."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        limits = [limit for limit in inner[1:] if isinstance(limit, Within | Interval | Printable)]
        return fits(value, inner[0]) and all(value in limit for limit in limits)
    if origin is Literal:
        return value in inner
    if origin in (Union, UnionType):
        return any(fits(value, option) for option in inner)
    if hint in PLAIN:
        wide = hint is float and isinstance(value, int) and abs(value) >= 2**63  # too large for torch
        return isinstance(value, PLAIN[hint]) and (hint is bool or not isinstance(value, bool)) and not wide
    if origin in (list, tuple) or hint in (list, tuple):
        if not isinstance(value, list | tuple) or not inner:
            return isinstance(value, list | tuple)
        items = inner[:1] * len(value) if repeats(hint) else inner
        return len(value) == len(items) and all(map(fits, value, items))
    if origin is dict or hint is dict:
        return isinstance(value, Mapping)
    if hint is Path:
        return isinstance(value, str | Path)
    plain = isinstance(value, str | int | float | list | dict | None)
    if not inspect.isclass(hint) or hint is Any or not plain:
        return True
    return hint.__module__ in ("builtins", "collections.abc", "numbers") and isinstance(value, hint)


def repeats(hint: Any) -> bool:
    """Return whether the annotation of a list or tuple applies to any length."""
    return get_origin(hint) is not tuple or get_args(hint)[1:] == (...,)


def describe(hint: Any) -> str:
    """Return an annotation in words for the user: `int`, `one of a, b`, `float or None`."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return str(inner[1]) if isinstance(inner[1], Interval) else f"{describe(inner[0])} {inner[1]}"
    if origin is Literal:
        return ("one of " if inner[1:] else "") + ", ".join(str(option) for option in inner)
    if origin in (Union, UnionType):
        names = {describe(option) for option in inner}  # the order depends on which spelling came first
        return " or ".join(sorted(names, key=lambda name: (name == "None", name.lower())))
    if origin in (list, tuple):
        return f"a list of {'' if repeats(hint) else f'{len(inner)} '}{describe(inner[0])}"
    return "None" if hint is NoneType else getattr(hint, "__name__", str(hint))
