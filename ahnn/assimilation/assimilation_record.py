"""Reading of an assimilation's output, thinned for figures and ephemerides."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.data.estimate_table import COVARIANCE, DEVIATION, FIRST, INNOVATION, rows_of, track_names
from ahnn.errors import UserError
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
