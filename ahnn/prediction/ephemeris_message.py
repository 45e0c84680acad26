"""Predictions as orbit ephemeris messages (CCSDS 502.0-B), with covariances if available."""

from __future__ import annotations

import torch

from ahnn.data.files import Covariance, Ephemeris
from ahnn.data.files.frame_names import FIXED_AT
from ahnn.data.files.object_name import ObjectName
from ahnn.data.files.units import LENGTH, TIME, unit
from ahnn.data.reference import Reference
from ahnn.data.start_states import UNKNOWN, Starts
from ahnn.errors import UserError
from ahnn.labels import require_velocities
from ahnn.prediction.durations import picoseconds
from ahnn.prediction.propagation import Prediction
from ahnn.types import Space

PLAIN = frozenset("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_./ ")
"""Characters allowed in a value of a message."""


def require_named(reference: Reference) -> None:
    """Raise UserError for a message without frame, centre, time system and epoch."""
    named = [name.partition(FIXED_AT)[0] for name in reference[:3]]
    if not all(named) or not PLAIN.issuperset("".join(named)):
        message = (
            "frame: expected frame, centre and time system for an ephemeris message, such as "
            f"frame=[EME2000,EARTH,UTC]; received {str(reference) or 'none'!r}"
        )
        raise UserError(message)
    if reference.epoch is None:
        message = (
            "epoch: expected the date of time zero for an ephemeris message; received none. Add "
            "epoch=2024-03-01T12:00:00"
        )
        raise UserError(message)


def ephemerides(prediction: Prediction, starts: Starts, space: Space) -> list[Ephemeris]:
    """Return a segment for each trajectory, in km, km/s and s; a single one without a name is unknown.

    Raises:
        UserError: a space without three positions in units of length, or a missing epoch, frame, centre or
            time system.
    """
    require_velocities(space, "output")
    position, second = unit(space.units.position), unit(space.units.time)
    if space.dof != 3 or position.dimension != LENGTH or second.dimension != TIME:
        message = (
            "output: expected three positions in a unit of length, and a unit of time, for an ephemeris "
            f"message; received {space.dof} in {space.units.position}, and {space.units.time}. Write .csv"
        )
        raise UserError(message)
    frame, center, clock, epoch = starts.reference
    require_named(starts.reference)
    assert epoch is not None
    km = position.size / 1e3
    speed = unit(space.units.velocity).size / 1e3 / space.mass
    scale = torch.tensor([km] * 3 + [speed] * 3, dtype=torch.float64)
    times = (prediction.times * second.size).numpy()
    matrices, segments = prediction.covariances, []
    unnamed = len(starts.objects) == 1 and not starts.known()
    for b, one in enumerate((ObjectName(UNKNOWN),) if unnamed else starts.objects):
        begin = epoch + picoseconds(float(starts.times[b]) + float(prediction.times[0]), space.units.time)
        known = () if matrices is None else (matrices[b] * scale * scale.unsqueeze(1)).numpy()
        since = times - times[0]
        segments.append(
            Ephemeris(
                object_id=_plain(one.designator or one.id),
                object_name=_plain(one.name),
                center=center,
                frame=frame.partition(FIXED_AT)[0],
                frame_epoch=frame.partition(FIXED_AT)[2],
                time_system=clock,
                start=begin,
                times=since,
                states=(prediction.states[b] * scale).numpy(),
                covariances=tuple(Covariance(float(t), c) for t, c in zip(since, known, strict=False)),
            )
        )
    return segments


def _plain(name: str) -> str:
    """Return a name with `_` in place of characters that are not allowed in a message."""
    return "".join(sign if sign in PLAIN else "_" for sign in name)
