"""Reading of an assimilation's output, thinned for figures and ephemerides."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.data.estimate_table import COVARIANCE, DEVIATION, FIRST, INNOVATION, rows_of, track_names
from ahnn.data.files import Covariance, Ephemeris, write_oem
from ahnn.data.reference import Reference
from ahnn.errors import UserError
from ahnn.labels import require_velocities
from ahnn.types import Space

Array = NDArray[np.float64]
MOST = 10_000
"""Maximum number of rows kept of an output, evenly spread."""


class AssimilationRecord(NamedTuple):
    """Selected rows of an output; of rows at the same time, the last.

    Attributes:
        time: (T,) increasing times.
        mean: (T, D) estimates.
        covariance: (T, D, D) covariances.
        outcome: (T,) outcomes in words.
        nis, dof: (T,) normalised innovation squared and its degrees of freedom.
        measured: names of the measured values.
        innovation, deviation: (T, M) innovations and their standard deviations, NaN where a value is missing.
        sensor: (T,) names of the sensors.
    """

    time: Array
    mean: Array
    covariance: Array
    outcome: NDArray[np.str_]
    nis: Array
    dof: Array
    measured: tuple[str, ...]
    innovation: Array
    deviation: Array
    sensor: NDArray[np.str_]


def read_record(path: Path, space: Space, most: int = MOST) -> AssimilationRecord:
    """Return at most `most` rows of an output, including the last one, in constant memory.

    Raises:
        UserError: the output has no rows.
    """
    stride = max(1, -(-sum(1 for _ in rows_of(path)) // most))
    kept: dict[float, dict[str, Any]] = {}
    row: dict[str, Any] = {}
    for k, row in enumerate(rows_of(path)):
        if k % stride == 0:
            kept[float(row["time"])] = row
    if not row:
        message = f"output: expected estimates; received none in {path}"
        raise UserError(message)
    kept[float(row["time"])] = row
    rows, components, scales = [kept[time] for time in sorted(kept)], track_names(space), space.scales.numpy()
    size = len(components)
    measured = tuple(n.removeprefix(DEVIATION) for n in row if n.startswith(DEVIATION))

    def columns(names: list[str]) -> Array:
        return np.array([[_number(row[name]) for name in names] for row in rows])

    covariance = np.zeros((len(rows), size, size))
    for i in range(size):
        for j in range(i + 1):
            (covariance[:, i, j],) = columns([f"{COVARIANCE}{components[i]}_{components[j]}"]).T
            covariance[:, j, i] = covariance[:, i, j]
    time, nis, dof = columns(["time", "nis", "dof"]).T
    sensor, outcome = (np.array([row[name] for row in rows]) for name in FIRST[2:4])
    found, sds = (columns([prefix + name for name in measured]) for prefix in (INNOVATION, DEVIATION))
    mean, covariance = scales * columns([*components]), covariance * scales * scales[:, None]
    return AssimilationRecord(time, mean, covariance, outcome, nis, dof, measured, found, sds, sensor)


def _number(cell: Any) -> float:
    return np.nan if cell is None or cell == "" else float(cell)


def require_orbit(space: Space, reference: Reference) -> None:
    """Check that estimates form an orbit with a known frame, centre and epoch.

    Raises:
        UserError: they do not; the message names the missing keys.
    """
    if len(space.components) != 6 or space.units[:3] != ("s", "km", "km/s"):
        message = (
            f"oem: expected an orbit in s, km and km/s; received {space.name} in {', '.join(space.units[:3])}"
        )
        raise UserError(message)
    require_velocities(space, "oem")
    example = ("frame=EME2000", "center=EARTH", "time_system=UTC", "epoch=2024-03-01T12:00:00")
    if missing := [word for word, value in zip(example, reference, strict=True) if value in ("", None)]:
        keys = ", ".join(word.partition("=")[0] + "=" for word in missing)
        message = (
            f"oem: expected {keys} for the estimates, which neither the model nor the start states; received "
            f"none. Add, for example, {' '.join(missing)}"
        )
        raise UserError(message)


def write_ephemeris(
    path: Path,
    record: AssimilationRecord,
    space: Space,
    name: str,
    reference: Reference,
    identifier: str = "",
) -> None:
    """Write orbit estimates with covariances as an orbit ephemeris message.

    Args:
        path: path of the message.
        record: estimates, positions in km and momenta in km/s times mass.
        space: description of the state components.
        name: name of the object.
        reference: frame, centre, time scale and epoch of time zero.
        identifier: identifier of the object; "": its name.

    Raises:
        UserError: see `require_orbit`.
    """
    require_orbit(space, reference)
    frame, center, clock, epoch = reference
    assert epoch is not None
    scale = np.array([1.0] * 3 + [1.0 / space.mass] * 3)
    matrices = record.covariance * scale[:, None] * scale
    covariances = tuple(Covariance(float(t), matrix) for t, matrix in zip(record.time, matrices, strict=True))
    states = record.mean * scale
    about = identifier or name, name, center, frame, clock, epoch
    write_oem(path, [Ephemeris(*about, record.time, states, covariances)])
