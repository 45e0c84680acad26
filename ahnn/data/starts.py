"""Initial states of predictions and assimilations, from numbers or from files of many formats.

For all commands, frame, centre, epoch and covariance of a file are either used or rejected.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import torch
import yaml
from torch import Tensor

from ahnn.contents import plain_yaml
from ahnn.data.estimate_table import OF_FILTER, components_with_units, is_track, last_estimates, names_objects
from ahnn.data.files import Files, instant, units
from ahnn.data.files.epochs import SECOND
from ahnn.data.files.frame_names import LISTED, is_unknown
from ahnn.data.files.kinds import TABLES, holds_mean_elements, kind_of
from ahnn.data.files.object_name import ObjectName, numbered
from ahnn.data.files.raw import content_of, decoded
from ahnn.data.files.source import StartFiles
from ahnn.data.reference import Reference
from ahnn.data.start_covariances import covariances_of
from ahnn.data.start_frames import matrices_to
from ahnn.data.start_states import Starts
from ahnn.data.table_covariances import table_covariances
from ahnn.deviations import require_finite, state_deviations
from ahnn.errors import UserError
from ahnn.labels import require_velocities
from ahnn.numbers import as_float64
from ahnn.types import Space

log = logging.getLogger("ahnn")

PLAIN = (".yaml", ".yml", ".json")
RATES = ("position", "velocity")
KEYS = {"mean", "sd", "covariance", "frame", "epoch"}


def starts(
    given: str | list[Any] | None,
    space: Space,
    ours: Reference = Reference(),  # noqa: B008 - a tuple
    *,
    sd: Any = None,
    last: bool = False,
) -> Starts:
    """Read the initial states given by a user.

    Args:
        given: the path of a file, or numbers: one state or several.
        space: description of the model's state components.
        ours: frame, centre and time scale of the model; states in another frame are transformed.
        sd: standard deviations (`state_deviations`) that take precedence over a file, or None.
        last: whether to use the last state of each trajectory in a file, instead of the first.

    Raises:
        UserError: no or invalid states for the space, or an incompatible frame or centre.
    """
    if given is None:
        message = "start: expected an initial state; received none. Add start=[NUMBERS] or start=FILE"
        raise UserError(message)
    path = Path(given).expanduser() if isinstance(given, str) else None
    if path is not None and not path.is_file():
        reason = "not a regular file" if path.exists() else "No such file"
        message = f"start: expected numbers in brackets or a file; received {path}: {reason}"
        raise UserError(message)
    if path is None:
        found = of_numbers(given, space)
    elif is_track(path) or (path.suffix.lower() in PLAIN and not holds_mean_elements(path)):
        found = of_track(path, space) if is_track(path) else of_plain(path, space)
    else:
        found = of_files(path, space, last=last, known_sd=sd is not None)
    if path is not None:
        found = in_frame(found, ours, space, path)
    if sd is None:
        return found
    if found.covariances is not None:
        log.warning("start_sd replaces the covariance in %s", path)
    covariance = state_deviations(sd, space, "start_sd").square().diag()
    return found._replace(covariances=covariance.expand(len(found.states), -1, -1))


def of_one_state(given: str | list[Any] | None) -> bool:
    """Return whether a start is an unnamed state: numbers, plain values, or an estimate."""
    path = Path(given).expanduser() if isinstance(given, str) else None
    if path is None or is_track(path):
        return path is None or not names_objects(path)
    return path.suffix.lower() in PLAIN


def in_frame(found: Starts, ours: Reference, space: Space, path: Path) -> Starts:
    """Transform the starts of a file, and their covariances, to the frame of the model.

    Raises:
        UserError: an incompatible frame or centre, or a transformation without epoch.
    """
    own = found.reference
    frame = own.turn(ours, f"start {path}")
    if frame is None:
        if own.frame and not ours.frame:
            said = "start %s: the frame is %s; the model states no frame and is assumed to use the same one"
            known = f". {own.frame} is unknown; known frames: {LISTED}" if is_unknown(own.frame) else ""
            log.warning(said + known, path, own.frame)
        return found
    turn = matrices_to(frame, own, found.times, space, f"start {path}")
    known, since, own = found.covariances, found.since, own._replace(frame=frame)
    states = (turn @ found.states.unsqueeze(-1)).squeeze(-1)
    at = turn
    if since is not None:
        at = matrices_to(frame, found.reference, since[0], space, f"start {path}")
        since = since[0], (at @ since[1].unsqueeze(-1)).squeeze(-1)
    known = None if known is None else at @ known @ at.mT
    return found._replace(states=states, reference=own, covariances=known, since=since)


def referred(found: Starts, ours: Reference) -> Starts:
    """Return starts with the model's reference, completed by that of their file.

    Their times are relative to the epoch of the file, if any.
    """
    own, clock = found.reference, ours.clock or found.reference.clock
    since = own if own.epoch is not None else ours
    whole = ours.filled(own)._replace(clock=clock, epoch=since.on(clock).epoch)
    return found._replace(reference=whole)


def of_numbers(given: Any, space: Space) -> Starts:
    """Build starts at time zero from numbers; raises UserError."""
    size = len(space.components)
    try:
        states = as_float64(given, "start")
    except ValueError as error:
        raise UserError(str(error)) from error
    if states.ndim not in (1, 2) or states.shape[-1] != size or not states.numel():
        known = ", ".join(components_with_units(space))
        message = f"start: expected one or more states [{known}]; received shape {tuple(states.shape)}"
        raise UserError(message)
    states = torch.atleast_2d(states)
    require_finite(states)
    return Starts(numbered(len(states)), states, states.new_zeros(len(states)))


def of_plain(path: Path, space: Space) -> Starts:
    """Read the state of a YAML or JSON file: mean, sd or covariance, frame, epoch; raises UserError."""
    try:
        content = plain_yaml(decoded(content_of(path), path))
    except (yaml.YAMLError, RecursionError) as error:
        reason = " ".join(str(error).split())
        message = f"start: expected a file with mean and either sd or covariance; received {path} ({reason})"
        raise UserError(message) from error
    unknown = {str(key) for key in content} - KEYS if isinstance(content, dict) else {"no keys"}
    if unknown or "mean" not in content or {"sd", "covariance"} <= content.keys():
        received = ", ".join(sorted(unknown)) or ("both" if "mean" in content else "no mean")
        message = (
            f"start: expected mean, either sd or covariance, frame and epoch in {path}; received {received}"
        )
        raise UserError(message)
    found = of_numbers(content["mean"], space)
    reference = Reference.of(str(content.get("frame", "")))
    if (epoch := content.get("epoch")) is not None:
        clock = reference.clock or "UTC"
        try:
            reference = reference._replace(clock=clock, epoch=instant(str(epoch), utc=clock == "UTC"))
        except ValueError as error:
            message = f"start {path}: expected {error}; received epoch {epoch}"
            raise UserError(message) from error
    covariance = content.get("covariance")
    if (sd := content.get("sd")) is not None:
        covariance = state_deviations(sd, space, f"start {path}: sd").square().diag()
    size = len(space.components)
    try:
        matrix = None if covariance is None else as_float64(covariance, "covariance").reshape(1, size, size)
    except (ValueError, RuntimeError) as error:
        message = (
            f"start {path}: expected a covariance of {size} x {size} numbers; received a different shape"
        )
        raise UserError(message) from error
    return found._replace(reference=reference, covariances=matrix)


def of_track(path: Path, space: Space) -> Starts:
    """Read the last estimate of each object in an assimilation's output; raises UserError."""
    found = last_estimates(path, space)
    names = found.names or (tuple(found.objects) if len(found.objects) == 1 else ())
    require_finite(found.means)
    objects = tuple(ObjectName(name, found.objects.get(name, "")) for name in names) or numbered(1)
    start = Starts(objects, found.means, found.times, found.reference, found.covariances)
    several = f" of each of {len(objects)} objects" if len(objects) > 1 else ""
    log.info("start %s: the last estimate%s, %s", path, several, start.first_time(space.units.time))
    return start


def of_files(path: Path, space: Space, *, last: bool, known_sd: bool) -> Starts:
    """Read the first or the last state of each trajectory in a data file; raises UserError."""
    kind = kind_of(content_of(path), str(path))
    second = 1.0 if kind in ("elements", "omm") else None  # interval of the two samples propagated by SGP4
    last = (last or OF_FILTER.encode() in content_of(path)) and second is None
    files = StartFiles("start", str(path), mass=space.mass, step=second, duration=second)
    if not files.momenta:
        require_velocities(space, f"start {path}")
    reference = Reference.of(files.space.frame)
    if files.epoch is not None:
        reference = reference._replace(epoch=files.epoch)
    order, factors = columns_of(files, space, path, by_order=kind not in TABLES)
    clock = factor(files.space.units.time, space.units.time, path)
    times, states = clock * files.trajectories.times, files.trajectories.states[..., order] * factors
    rows = torch.arange(len(states))
    columns = times.isfinite().sum(1) - 1 if last else torch.zeros_like(rows)
    chosen, moments = states[rows, columns], times[rows, columns]
    require_finite(chosen)
    objects = files.objects
    if not all(files.names):
        objects = tuple(
            one._replace(id=number.id) for one, number in zip(objects, numbered(len(objects)), strict=True)
        )
    found = Starts(objects, chosen, moments, reference)
    if second is not None:
        log.info("start %s: states of SGP4 at the epochs, accurate to kilometres (start_sd=)", path)
    elif (count := times.shape[1]) > 1:
        which, at = "last" if last else "first", found.first_time(space.units.time)
        whose = f"of {count} states" if len(objects) == 1 else f"state of each of {len(objects)} trajectories"
        log.info("start %s: the %s %s, %s", path, which, whose, at)
    own = files.trajectories.times[rows, columns]
    if not known_sd and (matrices := table_covariances(path, kind, own)) is not None:
        scale = factors if files.momenta else factors * space.scales
        return found._replace(covariances=matrices[:, order][:, :, order] * scale.outer(scale))
    if known_sd or files.epoch is None or kind not in ("oem", "xml", "opm"):
        return found
    size = units.unit(space.units.time).size
    since = [files.epoch + round(float(time) * size * SECOND) for time in moments]
    known = covariances_of(path, since, earlier=last)
    if known is None:
        return found
    weights = factors * torch.tensor([1.0] * 3 + [space.mass] * 3, dtype=torch.float64)
    covariances = known.matrices[:, order][:, :, order] * torch.outer(weights, weights)
    at = torch.tensor(
        [(moment - files.epoch) / SECOND / size for moment in known.moments], dtype=torch.float64
    )
    nearest = (times - at.unsqueeze(1)).abs().nan_to_num(torch.inf).argmin(1)
    if torch.equal(nearest, columns):
        return found._replace(covariances=covariances)
    return found._replace(covariances=covariances, since=(times[rows, nearest], states[rows, nearest]))


def columns_of(files: Files, space: Space, path: Path, *, by_order: bool) -> tuple[list[int], Tensor]:
    """Return the column indices of a space's components in a file, and conversion factors, (D,).

    Args:
        files: content of the file.
        space: description of the model's state components.
        path: path of the file.
        by_order: whether to assign positions with other names by order, as for orbit messages (x, y, z).

    Raises:
        UserError: missing or other columns, positions only, or incompatible units.
    """
    found, names, n = files.space, space.components[: space.dof], space.dof
    theirs = found.components[: found.dof]
    if by_order and found.dof == n and sorted(theirs) != sorted(names):
        theirs = names
    if sorted(theirs) != sorted(names) or files.positions_only:
        only, remedy = "", "Name the columns in a sidecar (docs/data.md)"
        if files.positions_only:
            only = " only"
            remedy = "The output of ahnn.assimilate for these positions can be used as a start"
        message = (
            f"start {path}: expected positions {', '.join(names)} and their velocities or momenta; received "
            f"{', '.join(theirs)}{only}. {remedy}"
        )
        raise UserError(message)
    order = [theirs.index(name) for name in names]
    parts = [factor(getattr(found.units, name), getattr(space.units, name), path) for name in RATES]
    return [*order, *(n + k for k in order)], torch.tensor(parts, dtype=torch.float64).repeat_interleave(n)


def factor(theirs: str, ours: str, path: Path) -> float:
    """Return the conversion factor of a unit in a file to ours; 1 for a file without units."""
    try:
        return 1.0 if theirs == "1" else units.factor(theirs, ours)
    except ValueError as error:
        message = f"start {path}: expected values in {ours} or in a compatible unit; received {theirs}"
        raise UserError(message) from error
