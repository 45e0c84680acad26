"""Schema of the metadata stored with weights, with types and limits, shared by all readers.

Run folders are exchanged between people, so their content is validated. Fields of other packages, absent from
every schema, are kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, TypeVar

from ahnn.arguments import Count, Finite, Positive, Text, Within, check_arguments
from ahnn.errors import UserError
from ahnn.types import Space, Units

T = TypeVar("T")

SAVED = "weights.safetensors"
"""File name of weights that were saved, exported or shipped, without a training."""


@dataclass(frozen=True, kw_only=True)
class About:
    """Metadata of weights."""

    dynamics: dict[str, Any]
    space: dict[str, Any]
    dt: Positive
    data: dict[str, Any] | None = None
    settings: dict[str, Any] | None = None
    domain: dict[str, Any] | None = None
    val_loss: float | None = None


@dataclass(frozen=True, kw_only=True)
class Made:
    """Fields common to all kinds of dynamics; each class checks its own further fields."""

    kind: Text
    dof: Count
    inertia: Positive | list[Positive] = 1.0


@dataclass(frozen=True, kw_only=True)
class Numbers:
    """Description of the state space."""

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
    """Provenance of the training trajectories."""

    recipe: dict[str, Any]
    split: tuple[Positive, Positive, Positive]


@dataclass(frozen=True, kw_only=True)
class Known:
    """Representative training states, in network inputs."""

    unit: Positive
    states: list[list[Finite]]


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Metadata of a parameter covariance."""

    weights: str
    inflation: Annotated[float, Within(1)]
    found: dict[str, Any]


def read(who: str, schema: type[T], content: Any) -> T:
    """Read the fields of a schema from plain values; other fields are ignored.

    Raises:
        UserError: no mapping, or a field that is missing, of the wrong type or outside its limits.
    """
    if not isinstance(content, Mapping):
        message = f"{who}: expected a mapping of keys to values; received {str(content)[:40]!r}"
        raise UserError(message)
    own = {field.name: content[field.name] for field in fields(schema) if field.name in content}  # pyright: ignore[reportArgumentType]
    check_arguments(who, schema, own)
    return schema(**own)


def read_about(who: str, content: Any) -> tuple[About, Space]:
    """Read the metadata of weights and the description of their state space.

    Raises:
        UserError: a field is missing, of the wrong type, outside its limits, or inconsistent with another
            field.
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
        message = (
            f"{who}.space.controls: expected different names, none of them a component; received "
            f"{str(said.controls)[:200]}"
        )
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
    masses = own["inertia"]  # may be NumPy scalars
    own["inertia"] = [float(m) for m in masses] if isinstance(masses, list) else float(masses)
    return {k: v for k, v in own.items() if k not in ("controls", "angles") or v}
