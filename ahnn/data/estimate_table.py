"""Reading of assimilation output: column names, rows, and the last estimate."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.contents import require_regular
from ahnn.data.files import sidecar
from ahnn.data.files.raw import content_of, decoded
from ahnn.data.reference import Reference
from ahnn.errors import UserError
from ahnn.labels import of_coordinates
from ahnn.types import Space

COVARIANCE, INNOVATION, DEVIATION = "cov_", "innovation_", "sd_"
FIRST = ("line", "time", "sensor", "outcome", "replayed", "nis", "dof")
DATED = (*FIRST[:2], "epoch", *FIRST[2:])
"""First columns where time zero has an epoch."""


class Last(NamedTuple):
    """The last estimate: time, mean (D,), covariance (D, D), and their reference."""

    time: float
    mean: Tensor
    covariance: Tensor
    reference: Reference


def is_track(path: Path) -> bool:
    """Return whether a file is the output of an assimilation: a table, or JSON lines."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        first = file.read(200).decode("utf-8", errors="replace")
    return first.startswith((",".join(FIRST[:4]), ",".join(DATED[:5]), f'{{"{FIRST[0]}": '))


def rows_of(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of an output."""
    require_regular(path)
    with path.open(newline="") as file:
        table = file.read(1) != "{"
        file.seek(0)
        yield from csv.DictReader(file) if table else map(json.loads, file)


def last_estimate(path: Path, space: Space) -> Last:
    """Read the last estimate in an output file, converted to the units of `space`.

    Raises:
        UserError: there is no estimate, or it belongs to another space.
    """
    names, scales, row = track_names(space), space.scales, {}
    lower = [(i, j) for i in range(len(names)) for j in range(i + 1)]
    covariance = torch.zeros(len(names), len(names), dtype=torch.float64)
    try:
        for row in rows_of(path):  # noqa: B007 - only the last one is used
            pass
        if names[-1] not in row:  # versions before 0.3 wrote momenta
            names, scales = space.components, torch.ones_like(scales)
        time, mean = float(row["time"]), [float(row[name]) for name in names]
        for i, j in lower:
            covariance[i, j] = covariance[j, i] = float(row[f"{COVARIANCE}{names[i]}_{names[j]}"])
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
    state, covariance = scales * torch.tensor(mean, dtype=torch.float64), covariance * scales.outer(scales)
    return Last(time, state, covariance, Reference.of(said.frame))


def track_names(space: Space) -> tuple[str, ...]:
    """Return the names of components in a track: velocities, or momenta that are not mass times velocity."""
    names = space.components
    return (*names[: space.dof], *(f"v{q}" for q in names[: space.dof])) if space.mechanical else names


def units_of(space: Space) -> dict[str, str]:
    """Return the units of time and of the components of a track, as for a sidecar."""
    names, units = track_names(space), momentum_units(space)
    if not space.mechanical:
        return units
    found = [of_coordinates(space, angle=angle).units for angle in space.angular]
    parts = [*(one.position for one in found), *(one.velocity for one in found)]
    return {"time": space.units.time, **dict(zip(names, parts, strict=True))}


def momentum_units(space: Space) -> dict[str, str]:
    """Return the units of time and components, momenta among them."""
    names, units = space.components, space.units
    momentum = {"1": "1", "rad": f"kg m^2/{units.time}"}.get(units.position, f"kg {units.velocity}")
    parts = [units.position] * space.dof + [momentum] * space.dof
    return {"time": units.time, **dict(zip(names, parts, strict=True))}


def described(space: Space, reference: Reference) -> sidecar.Sidecar:
    """Return the sidecar of an output: with it a reader of data takes the estimates as states."""
    names, dof = list(track_names(space)), space.dof
    rates = "velocities" if space.mechanical else "momenta"
    columns = {"time": "time", "positions": names[:dof], rates: names[dof:]}
    return sidecar.Sidecar(units_of(space), columns, str(reference))
