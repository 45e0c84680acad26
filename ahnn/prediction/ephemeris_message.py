"""Predictions as orbit ephemeris messages (CCSDS 502.0-B), with covariances if available."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from ahnn.data.files import Covariance, Ephemeris
from ahnn.data.files.frame_names import FIXED_AT
from ahnn.data.files.object_name import ObjectName
from ahnn.data.files.units import LENGTH, TIME, is_unit, unit
from ahnn.data.reference import Reference
from ahnn.data.start_states import UNKNOWN, Starts
from ahnn.errors import UserError
from ahnn.labels import require_velocities
from ahnn.prediction.durations import picoseconds
from ahnn.prediction.propagation import Prediction
from ahnn.types import Space

PLAIN = frozenset("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_./ ")
"""Characters allowed in a value of a message."""
SPEED = (0, 1, -1, 0)
"""Dimension of a length per time, as `LENGTH` and `TIME`."""
PARTS = ("frame", "centre", "time system", "the date of time zero")
STATED = (*("frame=[EME2000,EARTH,UTC]",) * 3, "epoch=2024-03-01T12:00:00")
"""Options that state these parts."""


def require_orbit(space: Space, reference: Reference, who: str = "", options: Sequence[str] = STATED) -> None:
    """Check that states form an orbit with a known frame, centre, time system and epoch.

    Args:
        space: description of the state components.
        reference: reference of positions and times.
        who: parameter that asks for the message; "": output, or the missing option.
        options: options that state the reference, for the remedy.

    Raises:
        UserError: they do not.
    """
    dimensions = [unit(text).dimension if is_unit(text) else None for text in space.units[:3]]
    if space.dof != 3 or dimensions != [TIME, LENGTH, SPEED]:
        message = (
            f"{who or 'output'}: expected an orbit, three positions in a unit of length, and a unit of time, "
            f"for an ephemeris message; received {space.dof} in {', '.join(space.units[:3])}. Write .csv"
        )
        raise UserError(message)
    require_velocities(space, who or "output")
    named = [name.partition(FIXED_AT)[0] for name in reference[:3]]
    stated = [*(name != "" and PLAIN.issuperset(name) for name in named), reference.epoch is not None]
    if not all(stated):
        parts = ", ".join(part for part, known in zip(PARTS, stated, strict=True) if not known)
        needed = [*dict.fromkeys(word for word, known in zip(options, stated, strict=True) if not known)]
        message = (
            f"{who or needed[0].partition('=')[0]}: expected {parts} for an ephemeris message; received "
            f"{str(reference) or 'none'!r}. Add, for example, {' '.join(needed)}"
        )
        raise UserError(message)


def ephemerides(prediction: Prediction, starts: Starts, space: Space) -> list[Ephemeris]:
    """Return a segment for each trajectory, in km, km/s and s; a single one without a name is unknown.

    Raises:
        UserError: see `require_orbit`.
    """
    require_orbit(space, starts.reference)
    position, second = unit(space.units.position), unit(space.units.time)
    frame, center, clock, epoch = starts.reference
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
