"""What stands beside weights: one schema with types and limits, which every door reads.

A run folder is shared between people, so nothing of it is taken as it is. Fields of other packages, which no
schema names, are kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, TypeVar

from ahnn.arguments import Count, Finite, Positive, Text, Within, check_arguments
from ahnn.errors import UserError
from ahnn.types import Space, Units

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class About:
    """What weights belong to."""

    dynamics: dict[str, Any]
    space: dict[str, Any]
    dt: Positive
    data: dict[str, Any] | None = None
    settings: dict[str, Any] | None = None
    domain: dict[str, Any] | None = None
    val_loss: float | None = None


@dataclass(frozen=True, kw_only=True)
class Made:
    """What every kind of dynamics is made of; the rest is checked by its own class."""

    kind: Text
    dof: Count
    inertia: Positive | list[Positive] = 1.0


@dataclass(frozen=True, kw_only=True)
class Numbers:
    """What the numbers of a state mean."""

    name: Text
    components: list[Text]
    units: tuple[Text, Text, Text, Text]
    inertia: Positive | list[Positive]
    frame: Text = ""
    mechanical: bool = True
    controls: list[Text] = field(default_factory=list)
    angles: list[Text] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Data:
    """Which trajectories a training was made of."""

    recipe: dict[str, Any]
    split: tuple[Positive, Positive, Positive]


@dataclass(frozen=True, kw_only=True)
class Known:
    """Training states that stand for all, in inputs of the networks."""

    unit: Positive
    states: list[list[Finite]]


@dataclass(frozen=True, kw_only=True)
class Spread:
    """What stands beside a covariance of parameters."""

    weights: str
    inflation: Annotated[float, Within(1)]
    found: dict[str, Any]


def read(who: str, schema: type[T], content: Any) -> T:
    """Return the fields of a schema from plain values; others are left alone.

    Raises:
        UserError: no keys with values, a field that is missing, of another type or beyond its limits.
    """
    if not isinstance(content, Mapping):
        message = f"{who}: expected keys with values; received {str(content)[:40]!r}"
        raise UserError(message)
    own = {field.name: content[field.name] for field in fields(schema) if field.name in content}  # pyright: ignore[reportArgumentType]
    check_arguments(who, schema, own)
    return schema(**own)


def read_about(who: str, content: Any) -> tuple[About, Space]:
    """Return what weights belong to, and what the numbers of their states mean.

    Raises:
        UserError: a field is missing, of another type, beyond its limits, or does not fit the others.
    """
    about = read(who, About, content)
    made = read(f"{who}.dynamics", Made, {"dof": 1, **about.dynamics})
    said = read(f"{who}.space", Numbers, about.space)
    if about.data is not None:
        read(f"{who}.data", Data, about.data)
    names, dof = tuple(said.components), about.dynamics.get("dof", len(said.components) // 2)
    if len({*names}) < len(names) or len(names) != 2 * dof or not all((names, *names)):
        message = f"{who}.space.components: expected {2 * dof} different names; received {str(names)[:200]}"
        raise UserError(message)
    if len({*names, *said.controls, ""}) <= len(names) + len(said.controls):
        message = f"{who}.space.controls: expected names of their own; received {str(said.controls)[:200]}"
        raise UserError(message)
    if about.dynamics.get("inertia", said.inertia) != said.inertia:
        message = f"{who}.dynamics.inertia: expected {said.inertia}, as in space; received {made.inertia}"
        raise UserError(message)
    inertia = tuple(said.inertia) if isinstance(said.inertia, list) else said.inertia
    if isinstance(inertia, tuple) and len(inertia) != dof:
        message = f"{who}.space.inertia: expected one number, or {dof}; received {inertia}"
        raise UserError(message)
    more = {"controls": tuple(said.controls), "angles": tuple(said.angles), "mechanical": said.mechanical}
    space = Space(said.name, names, Units(*said.units), inertia, said.frame, **more)
    return about, space


def about_space(space: Space) -> dict[str, Any]:
    """Return a space as plain values, as `read_about` reads them."""
    own = {k: [*v] if isinstance(v, tuple) else v for k, v in space._asdict().items()}
    return {k: v for k, v in own.items() if k not in ("controls", "angles") or v}
