"""Reading of assimilation output: column names, rows, and the last estimates."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.contents import require_regular
from ahnn.data.files import sidecar
from ahnn.data.files.columns import COVARIANCES
from ahnn.data.files.raw import content_of, decoded
from ahnn.data.reference import Reference
from ahnn.errors import UserError
from ahnn.labels import momentum_unit, of_coordinates
from ahnn.types import Space

COVARIANCE, INNOVATION, DEVIATION = COVARIANCES, "innovation_", "innovation_sd_"
FIRST = ("line", "time", "sensor", "outcome", "replayed", "nis", "dof")
DATED = (*FIRST[:2], "epoch", *FIRST[2:])
"""First columns if time zero has an epoch."""
OBJECT = "object"
"""Name of the column of object names, the second column in the output for many objects."""
OF_OBJECTS = re.compile(rf'{FIRST[0]},{OBJECT},{FIRST[1]},|{{"{FIRST[0]}": \d+, "{OBJECT}": ')
"""Beginning of the output for many objects, a table or JSON lines."""


class LastEstimates(NamedTuple):
    """Last estimate of each object.

    Attributes:
        names: names of the B objects; empty for a single object without a name.
        times: (B,) times.
        means: (B, D) means.
        covariances: (B, D, D) covariances.
        reference: reference of positions and times.
        objects: names of the objects by their identifiers, as far as known.
    """

    names: tuple[str, ...]
    times: Tensor
    means: Tensor
    covariances: Tensor
    reference: Reference
    objects: dict[str, str] = {}  # noqa: RUF012 - never written to


OF_FILTER = "Estimates of ahnn.assimilate"
"""Comment of an orbit message with the estimates of a filter, of which a prediction starts from the last."""


def is_track(path: Path) -> bool:
    """Return whether a file is the output of an assimilation: a table, or JSON lines."""
    first = _beginning(path)
    known = (",".join(FIRST[:4]), ",".join(DATED[:5]), f'{{"{FIRST[0]}": ')
    return first.startswith(known) or OF_OBJECTS.match(first) is not None


def names_objects(path: Path) -> bool:
    """Return whether a file is the output of an assimilation for many objects."""
    return OF_OBJECTS.match(_beginning(path)) is not None


def _beginning(path: Path) -> str:
    """Return the first characters of a file; "" if there is no file."""
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        return file.read(200).decode("utf-8", errors="replace")


def rows_of(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of an output file."""
    require_regular(path)
    with path.open(newline="") as file:
        table = file.read(1) != "{"
        file.seek(0)
        yield from csv.DictReader(file) if table else map(json.loads, file)


def last_estimates(path: Path, space: Space) -> LastEstimates:
    """Read the last estimate of each object in an output file, converted to the units of `space`.

    Raises:
        UserError: there is no estimate, or it belongs to another space.
    """
    names, scales, row, rows = track_names(space), space.scales, {}, dict[str, dict[str, Any]]()
    lower = [(i, j) for i in range(len(names)) for j in range(i + 1)]
    try:
        for row in rows_of(path):
            rows[row.get(OBJECT) or ""] = row
        if names[-1] not in row:  # versions before 0.3 wrote momenta
            names, scales = space.components, torch.ones_like(scales)
        columns = ["time", *names, *(f"{COVARIANCE}{names[i]}_{names[j]}" for i, j in lower)]
        numbers = [[float(one[name]) for name in columns] for one in rows.values() or [row]]
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        received = f"an invalid row ({error})" if row else "no row"
        message = f"start {path}: expected estimates of {', '.join(names)}; received {received}"
        raise UserError(message) from error
    said = sidecar.Sidecar()
    if (aside := sidecar.beside(path)).is_file():
        said = sidecar.parse(decoded(content_of(aside), aside), str(aside))
    units = units_of(space) if names == track_names(space) else momentum_units(space)
    for name, unit in said.units.items():
        if name in units and unit != units[name]:
            message = f"start {path}: expected {name} in {units[name]}, as in the model; received {unit}"
            raise UserError(message)
    values = torch.tensor(numbers, dtype=torch.float64)
    times, means, triangles = values.tensor_split([1, 1 + len(names)], dim=1)
    covariances = torch.zeros(len(values), len(names), len(names), dtype=torch.float64)
    for k, (i, j) in enumerate(lower):
        covariances[:, i, j] = covariances[:, j, i] = triangles[:, k]
    objects = () if list(rows) == [""] else tuple(rows)
    whole = covariances * scales.outer(scales)
    about = Reference.of(said.frame), said.objects
    return LastEstimates(objects, times[:, 0], scales * means, whole, *about)


def track_names(space: Space) -> tuple[str, ...]:
    """Return the names of components in a track: velocities, or momenta that are not mass times velocity."""
    names = space.components
    return (*names[: space.dof], *(f"v{q}" for q in names[: space.dof])) if space.mechanical else names


def units_of(space: Space) -> dict[str, str]:
    """Return the units of time and of the components of a track, in the form of a sidecar."""
    names, units = track_names(space), momentum_units(space)
    if not space.mechanical:
        return units
    found = [of_coordinates(space, angle=angle).units for angle in space.angular]
    parts = [*(one.position for one in found), *(one.velocity for one in found)]
    return {"time": space.units.time, **dict(zip(names, parts, strict=True))}


def components_with_units(space: Space) -> list[str]:
    """Return the components of a state with their units, momenta in units of velocity times inertia."""
    units = [*units_of(space).values()][1:]
    if not space.mechanical:
        units[space.dof :] = [momentum_unit(space)] * space.dof
    parts = zip(space.components, units, space.scales.tolist(), strict=True)
    return [f"{name} [{unit}{'' if scale == 1 else f' x {scale:g}'}]" for name, unit, scale in parts]


def momentum_units(space: Space) -> dict[str, str]:
    """Return the units of time and components, including momenta."""
    names, units = space.components, space.units
    momentum = {"1": "1", "rad": f"kg m^2/{units.time}"}.get(units.position, f"kg {units.velocity}")
    parts = [units.position] * space.dof + [momentum] * space.dof
    return {"time": units.time, **dict(zip(names, parts, strict=True))}


def described(
    space: Space, reference: Reference, objects: Mapping[str, str] | None = None
) -> sidecar.Sidecar:
    """Return the sidecar of an output, with which its estimates can be read as states.

    Args:
        space: description of the state components.
        reference: reference of positions and times.
        objects: names of the objects by their identifiers; None: unknown.
    """
    names, dof = list(track_names(space)), space.dof
    rates = "velocities" if space.mechanical else "momenta"
    columns = {"time": "time", "positions": names[:dof], rates: names[dof:]}
    return sidecar.Sidecar(units_of(space), columns, str(reference), objects=dict(objects or {}))
