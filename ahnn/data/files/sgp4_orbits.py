"""Orbits propagated by SGP4 from mean elements in any notation.

Hoots and Roehrich, Spacetrack Report 3 (1980), as revised by Vallado et al., AIAA 2006-6753.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.data.files import epochs
from ahnn.data.files.content import Content
from ahnn.data.files.ephemeris import of_orbits
from ahnn.data.files.samples import Track
from ahnn.data.files.table import Fault, Note, Place, Remark, refuse
from ahnn.errors import UserError
from ahnn.optional_libraries import library

FRAME = "TEME, EARTH, UTC"


class MeanOrbit(NamedTuple):
    """Mean elements for SGP4.

    Attributes:
        place: place in the file.
        name: name of the satellite.
        satellite: `Satrec` of the package sgp4.
        epoch: epoch in picoseconds (`epochs.instant`).
        title: name of the satellite besides its identifier `name`; "" if there is none.
        designator: international designator, such as 2014-069A; "" if there is none.
    """

    place: Place
    name: str
    satellite: Any
    epoch: int
    title: str = ""
    designator: str = ""


def sgp4_content(
    orbits: Callable[[Any, Note], Iterator[MeanOrbit]],
    file: str,
    span: tuple[float | None, float | None],
    *,
    named: str,
    expected: str,
    unused: str,
    note: Note = refuse,
) -> Content:
    """Return a trajectory for each set of mean elements, starting at its epoch.

    Args:
        orbits: generator of mean elements, called with the module `sgp4.api` and the fault callback.
        file: file name, for messages.
        span: sampling interval and duration of each trajectory, in seconds.
        named: name used for the elements in messages.
        expected: expected content, for the message about a file without elements.
        unused: remark on fields not needed by SGP4.
        note: callback for elements that are damaged or cannot be propagated.

    Raises:
        UserError: no step or duration, no elements, or an error raised by `note`.
    """
    step, duration = span
    if step is None or duration is None or duration < step:
        message = (
            "step, duration: expected the sampling interval and duration, in seconds, of the trajectories "
            f"that SGP4 propagates from the {named} in {file}; received {step} and {duration}. Set "
            "step=SECONDS and duration=SECONDS; in ahnn.train, system.step and system.duration"
        )
        raise UserError(message)
    model = library("sgp4.api", "sgp4", "orbit", file)
    times = step * np.arange(int(duration / step + 1e-9) + 1, dtype=np.float64)
    tracks, starts = [], []
    for one in orbits(model, note):
        try:
            track = propagated(model, one, times)
        except Fault as fault:
            note(fault)
        else:
            tracks.append(track)
            starts.append(one.epoch)
    note(Remark(Place(file), unused))
    if not tracks:
        Place(file).refuse(expected, "none")
    first = min(starts)
    shifted = [
        track._replace(times=track.times + (start - first) / epochs.SECOND)
        for track, start in zip(tracks, starts, strict=True)
    ]
    return of_orbits(shifted, FRAME, first)


def propagated(model: Any, one: MeanOrbit, times: NDArray[np.float64]) -> Track:
    """Propagate mean elements; raises Fault if SGP4 fails."""
    whole = np.full(len(times), one.satellite.jdsatepoch)
    fractions = one.satellite.jdsatepochF + times / epochs.DAY
    codes, positions, velocities = one.satellite.sgp4_array(whole, fractions)
    if len(wrong := np.flatnonzero((codes != 0) | ~np.isfinite(positions).all(1))):
        reason, k = model.SGP4_ERRORS.get(int(codes[wrong[0]]), "no finite position"), wrong[0]
        one.place.refuse(
            "elements that SGP4 can propagate", f"after {times[k]:g} s: {reason}", "Shorten system.duration"
        )
    rows = np.full(len(times), one.place.row, dtype=np.int64)
    states = np.concatenate((positions, velocities), axis=1)
    return Track(one.name, one.place.file, rows, times, states, None, one.title, one.designator)
