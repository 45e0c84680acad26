"""Validation of trajectories passed from Python, and their conversion to file content."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ahnn.arguments import Positive, check_values, fits
from ahnn.data.files.content import Content
from ahnn.data.files.samples import Track
from ahnn.data.files.table import FINITE, LARGEST
from ahnn.data.files.units import unit
from ahnn.data.files.unwrapped_angles import unwrapped
from ahnn.errors import UserError
from ahnn.numbers import as_float64, described
from ahnn.types import Space, Trajectories, Units


def check_space(space: Space) -> None:
    """Raise UserError for invalid names, units or inertia, or an odd number of components."""
    if not isinstance(space, Space):
        message = f"space: expected ahnn.Space(name, components); received {described(space)}"
        raise UserError(message)
    check_values("space", Space, space._asdict())
    if not isinstance(space.units, Units):
        message = f"space.units: expected ahnn.Units(...); received {space.units!r}"
        raise UserError(message)
    check_values("space.units", Units, space.units._asdict())
    for text in (space.name, *space.components, *space.controls, *space.units):
        if not text.strip() or not text.isprintable() or "$" in text:
            message = f"space: expected printable names and units without $; received {text!r}"
            raise UserError(message)
    dof = space.dof  # raises unless the components are pairs
    masses = space.inertia if isinstance(space.inertia, tuple) else (space.inertia,)
    if not all(fits(mass, Positive) for mass in masses) or len(masses) not in (1, dof):
        message = f"space.inertia: expected finite numbers > 0, one or {dof}; received {space.inertia!r}"
        raise UserError(message)
    named = (*space.components, *space.controls)
    if again := [name for name in named if named.count(name) > 1]:
        key = "controls" if again[0] in space.controls else "components"
        message = f"space.{key}: expected different names; received {again[0]!r} twice"
        raise UserError(message)


def check_trajectories(given: Trajectories, space: Space) -> Trajectories:
    """Validate trajectories; return float64 states (B, T, D), or positions (B, T, n), and times (B, T).

    Raises:
        UserError: an invalid space, incompatible shapes, infinite values, or times that do not increase.
    """
    check_space(space)
    if not isinstance(given, Trajectories):
        message = f"trajectories: expected ahnn.Trajectories(states, times); received {described(given)}"
        raise UserError(message)
    states = as_float64(given.states, "states", torch.device("cpu")).detach()
    times = as_float64(given.times, "times", torch.device("cpu")).detach()
    size = len(space.components)
    if states.ndim != 3 or states.shape[-1] not in (size, space.dof) or min(states.shape) < 1:
        message = (
            f"states: expected shape (trajectories, samples, {size}), the components "
            f"{', '.join(space.components)}; received {tuple(states.shape)}. Without velocities there are "
            f"{space.dof} columns"
        )
        raise UserError(message)
    if times.shape not in (states.shape[:2], states.shape[1:2]):
        message = (
            f"times: expected shape {tuple(states.shape[:2])}, or {tuple(states.shape[1:2])} for all "
            f"trajectories; received {tuple(times.shape)}"
        )
        raise UserError(message)
    for name, part in (("states", states), ("times", times)):
        if bool((beyond := part.abs() > LARGEST).any()):
            received = float(part[beyond][0])
            message = f"{name}: expected {FINITE}, NaN where a sample is absent; received {received:g}"
            raise UserError(message)
    trajectories = Trajectories(states, times).each_timed()
    steps = trajectories.times.diff(dim=1)
    if bool((steps <= 0).any()):
        b, k = (int(n) for n in (steps <= 0).nonzero()[0])
        pair = trajectories.times[b, k : k + 2].tolist()
        message = f"times: expected increasing times; received {pair} from sample {k} of trajectory {b}"
        raise UserError(message)
    unknown = trajectories.times.isnan()
    if bool((unknown[:, :-1] & ~unknown[:, 1:]).any()):
        message = "times: expected NaN only after the last sample of a trajectory; received NaN before a time"
        raise UserError(message)
    return trajectories


def check_states(given: Trajectories, dof: int) -> Trajectories:
    """Validate trajectories of full states, n = `dof`; return float64 states (B, T, 2n) and times (B, T).

    Raises:
        UserError: invalid trajectories (see `check_trajectories`), or positions without momenta.
    """
    names = tuple(f"{letter}{k}" for letter in "qp" for k in range(dof))
    trajectories = check_trajectories(given, Space("data", names))
    if trajectories.states.shape[-1] != 2 * dof or not bool(trajectories.present.any()):
        message = (
            f"data: expected states [q, p] of {2 * dof} components, NaN where missing; received shape "
            f"{tuple(trajectories.states.shape)}. For positions without velocities use ahnn.fit"
        )
        raise UserError(message)
    return trajectories


def check_controls(given: Trajectories, space: Space, times: Tensor) -> Tensor | None:
    """Validate controls; return a float64 tensor (B, T, m), or None for a space without controls.

    Raises:
        UserError: a wrong shape, or a missing value at a known time.
    """
    if given.controls is None and not space.controls:
        return None
    shape = (*times.shape, len(space.controls))
    received = None if given.controls is None else as_float64(given.controls, "controls", times.device)
    if received is None or not space.controls or received.shape != shape:
        expected = f"shape {shape}, as space.controls names {', '.join(space.controls) or 'none'}"
        message = f"controls: expected {expected}; received {described(received)}"
        raise UserError(message)
    wrong = ~(received.abs() <= LARGEST).all(-1) & times.isfinite()
    if bool(wrong.any()):
        b, k = (int(n) for n in wrong.nonzero()[0])
        message = (
            f"controls: expected {FINITE} at each time; received {received[b, k].tolist()} at sample {k} of "
            f"trajectory {b}"
        )
        raise UserError(message)
    return received.detach()


def content_of(given: Trajectories, space: Space) -> Content:
    """Convert trajectories to file content; momenta that are all NaN mean positions only.

    Raises:
        UserError: invalid trajectories; see `check_trajectories`.
    """
    states, times, *_ = check_trajectories(given, space)
    controls = check_controls(given, space, times)
    q, p = space.components[: space.dof], space.components[space.dof :]
    alone = bool(states[..., len(q) :].isnan().all())
    values = (states[..., : len(q)] if alone else states).numpy()
    rows, tracks = np.arange(1, times.shape[1] + 1), []
    for b, row in enumerate(times.numpy()):
        known = row[np.isfinite(row)]
        own = None if controls is None else controls[b, : len(known)].numpy()
        tracks.append(Track("", f"trajectory {b}", rows[: len(known)], known, values[b, : len(known)], own))
    units = Units(*map(_known, space.units))
    about = {"time": "times", "controls": space.controls, "linear": given.linear}
    return unwrapped(Content(q, () if alone else p, True, units, space.frame, (*tracks,), **about))


def _known(text: str) -> str:
    """Return a known unit, or the dimensionless unit in place of a custom one."""
    try:
        unit(text)
    except ValueError:
        return "1"
    return text
