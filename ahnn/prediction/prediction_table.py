"""Predictions as CSV or Parquet tables with units in column names."""

from __future__ import annotations

from typing import Any

import numpy as np

from ahnn.data.files import epochs
from ahnn.data.files.columns import COVARIANCES
from ahnn.data.files.content import CANONICAL
from ahnn.data.files.object_name import names_by_id
from ahnn.data.files.sidecar import Sidecar
from ahnn.data.files.units import product
from ahnn.data.starts import Starts
from ahnn.labels import physical_components
from ahnn.prediction.durations import picoseconds
from ahnn.prediction.propagation import Prediction
from ahnn.types import Space
from ahnn.uncertainty import BEYOND


def columns(
    prediction: Prediction, starts: Starts, space: Space, *, correlated: bool = False
) -> dict[str, Any]:
    """Return the columns of all trajectories, concatenated.

    Momenta proportional to velocities are written as velocities, with the names of docs/data.md; `sd_` marks
    a standard deviation, and `novel` is 1 for states outside the training data.

    Args:
        prediction: prediction to write.
        starts: names, times and reference of the starts.
        space: description of the state components.
        correlated: whether to write covariances too, the lower triangle with the names of a track.
    """
    samples = prediction.states.shape[1]
    times = (starts.times.unsqueeze(1) + prediction.times).flatten()
    found: dict[str, Any] = {"id": np.repeat(np.asarray(starts.names), samples)}
    found[f"t [{space.units.time}]"] = times.numpy()
    if (epoch := starts.reference.epoch) is not None:
        utc = starts.reference.clock == "UTC"
        moments = (epoch + picoseconds(float(t), space.units.time) for t in times)
        found["epoch"] = np.asarray([epochs.spelled(moment, utc=utc) for moment in moments])
    names, factors = physical_components(space), 1 / space.scales.numpy()
    for prefix, values in (("", prediction.states), ("sd_", prediction.deviations)):
        if values is not None:
            rows = values.flatten(0, 1).numpy() * factors
            found |= {f"{prefix}{name}": rows[:, k] for k, name in enumerate(names)}
    if correlated and prediction.covariances is not None:
        scaled = prediction.covariances.flatten(0, 1).numpy() * np.outer(factors, factors)
        parts = [name.removesuffix("]").split(" [") for name in names]
        for i, (a, unit) in enumerate(parts):
            for j, (b, other) in enumerate(parts[: i + 1]):
                found[f"{COVARIANCES}{a}_{b} [{product(unit, other)}]"] = scaled[:, i, j]
    if prediction.novelty is not None:
        found["novelty [1]"] = prediction.novelty.flatten().numpy()
        found["novel [1]"] = (prediction.novelty.flatten() > BEYOND).numpy().astype(np.int64)
    return found


def described(starts: Starts, space: Space) -> Sidecar:
    """Return the sidecar that makes data readers interpret a prediction table as trajectories."""
    names, momenta = list(space.components[: space.dof]), list(space.components[space.dof :])
    reference = starts.reference
    rates = {"velocities": [f"v{name}" for name in names]} if space.mechanical else {"momenta": momenta}
    time = "t" if reference.epoch is None else "epoch"
    columns = {"time": time, "id": "id", "positions": names, **rates}
    units = {} if reference.epoch is None else {"epoch": reference.clock or "UTC"}
    frame, mass = str(reference._replace(epoch=None)), "" if space.mechanical else CANONICAL
    return Sidecar(units, columns, frame, objects=names_by_id(starts.objects), mass=mass)


def as_csv(found: dict[str, Any]) -> bytes:
    """Return columns as comma-separated values, with full precision."""
    rows = zip(*(column.tolist() for column in found.values()), strict=True)
    lines = [",".join(map(_cell, found)), *(",".join(map(_cell, row)) for row in rows)]
    return ("\n".join(lines) + "\n").encode()


def _cell(value: Any) -> str:
    text = value if isinstance(value, str) else repr(value)
    return '"' + text.replace('"', '""') + '"' if any(sign in text for sign in ',;"\t') else text
