"""Where predictions begin: numbers in brackets, or the first sample of each trajectory in files."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.data.files import Files, instant, units
from ahnn.errors import UserError
from ahnn.labels import momentum_unit, require_velocities
from ahnn.numbers import as_float64
from ahnn.prediction.kernel import require_finite
from ahnn.types import Space


class Starts(NamedTuple):
    """States at which predictions begin.

    Attributes:
        names: of the trajectories.
        states: (B, D), in the units of the space.
        times: (B,) of the states, in its unit of time.
        frame: in which a file gives positions, "" where nobody said.
        epoch: at which times are zero (`ahnn.data.files.epochs`); None where times are numbers.
    """

    names: tuple[str, ...]
    states: Tensor
    times: Tensor
    frame: str = ""
    epoch: int | None = None


def starts(given: str | list[Any], space: Space) -> Starts:
    """Return the starts that a user names.

    Args:
        given: the path of a file as `system=files` reads them, or numbers: one state or several.
        space: what the numbers of the model mean.

    Raises:
        UserError: they are no states of this space.
    """
    return _from_file(given, space) if isinstance(given, str) else _from_numbers(given, space)


def _from_numbers(given: list[Any], space: Space) -> Starts:
    try:
        states = as_float64(given, "start")
    except ValueError as error:
        raise UserError(str(error)) from error
    size = len(space.components)
    if states.ndim not in (1, 2) or states.shape[-1] != size or not states.numel():
        known = ", ".join(_with_units(space))
        message = f"start: expected one state or several of [{known}]; received shape {tuple(states.shape)}"
        raise UserError(message)
    states = torch.atleast_2d(states)
    require_finite(states)
    return Starts(numbered(len(states)), states, states.new_zeros(len(states)))


def _from_file(path: str, space: Space) -> Starts:
    files = Files("start", path, mass=space.inertia)
    if not files.momenta:
        require_velocities(space, f"start {path}")
    found, names, n = files.space, space.components[: space.dof], space.dof
    theirs = found.components[: found.dof]
    if sorted(theirs) != sorted(names) or files.positions_only:
        alone = " alone" if files.positions_only else ""
        message = (
            f"start {path}: expected positions {', '.join(names)} and their velocities or momenta; received "
            f"{', '.join(theirs)}{alone}. Name the columns in a sidecar, docs/data.md"
        )
        raise UserError(message)
    order = [theirs.index(name) for name in names]
    first = files.trajectories.states[:, 0]
    q = first[:, order] * factor(found.units.position, space.units.position, path)
    p = first[:, [n + k for k in order]] * factor(found.units.velocity, space.units.velocity, path)
    times = files.trajectories.times[:, 0] * factor(found.units.time, space.units.time, path)
    states = torch.cat((q, p), dim=-1)
    require_finite(states)
    labels = files.names if all(files.names) else numbered(len(states))
    require_frame(space.frame, found.frame, path)
    return Starts(labels, states, times, ", ".join(words(found.frame)), files.epoch)


def words(frame: str) -> list[str]:
    """Return frame, centre and time system of a text such as `EME2000, EARTH, UTC, from 2024-...`."""
    return [word.strip() for word in frame.split(",")[:3]]


def require_frame(ours: str, theirs: str, path: str) -> None:
    """Refuse positions in another frame or about another centre; raises UserError."""
    if ours and theirs and words(ours)[:2] != words(theirs)[:2]:
        message = f"start {path}: expected frame {ours}, that of the model; received {theirs}"
        raise UserError(message)


def factor(theirs: str, ours: str, path: str) -> float:
    """Return what numbers in a unit of a file are multiplied with; a file without units has ours."""
    try:
        return 1.0 if theirs == "1" else units.factor(theirs, ours)
    except ValueError as error:
        message = f"start {path}: expected numbers in {ours}, or a unit that fits it; received {theirs}"
        raise UserError(message) from error


def numbered(count: int) -> tuple[str, ...]:
    """Return the numbers from 1 as names."""
    return tuple(str(k + 1) for k in range(count))


def _with_units(space: Space) -> list[str]:
    """Return the components with their units, those of momenta as of velocities times the inertia."""
    scale = "" if space.inertia == 1 else f" x {space.inertia:g}"
    momentum = f"{space.units.velocity}{scale}" if space.mechanical else momentum_unit(space)
    units = (space.units.position, momentum)
    return [f"{name} [{units[k >= space.dof]}]" for k, name in enumerate(space.components)]


def with_epoch(found: Starts, text: str | None, *, utc: bool) -> Starts:
    """Return starts whose time zero is an epoch that a user names; None leaves what they have.

    Raises:
        UserError: no epoch, or a second one beside that of a file.
    """
    if text is None:
        return found
    if found.epoch is not None:
        message = f"epoch: expected none, since the file of the start has its own; received {text}"
        raise UserError(message)
    try:
        return found._replace(epoch=instant(text, utc=utc))
    except ValueError as error:
        message = f"epoch: expected {error}; received {text!r}"
        raise UserError(message) from error
