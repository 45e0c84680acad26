"""Unwrapping of angles that were wrapped to one turn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ahnn.data.files.content import Content
from ahnn.data.files.samples import Track
from ahnn.data.files.table import Note, Place, Remark, refuse
from ahnn.data.files.units import ANGLE, unit

TURN = 2.0 * np.pi
NEAR, SMALL = 1.0, 8.0
"""Criteria of a wrap: distance of a step from one turn in rad, and its ratio to typical steps."""


def unwrapped(content: Content, note: Note = refuse) -> Content:
    """Unwrap the angular positions of content at jumps by one turn.

    Args:
        content: content of a file, with angles in rad.
        note: callback for each column with jumps.
    """
    if unit(content.units.position).dimension != ANGLE:
        return content
    tracks, count = list(content.tracks), np.zeros(len(content.positions), dtype=np.int64)
    for k, track in enumerate(content.tracks):
        turns = turns_of(track, len(count))
        if turns.any():
            values = track.values.copy()
            values[:, : len(count)] -= TURN * turns.cumsum(axis=0)
            tracks[k] = track._replace(values=values)
            count += np.abs(turns).sum(axis=0)
    for name, times in zip(content.positions, count.tolist(), strict=True):
        if times:
            what = f"an angle that jumps by a full turn, {times:,} times: read as continuous"
            note(Remark(Place(content.tracks[0].file, content.head, name), what))
    return content._replace(tracks=tuple(tracks))


def turns_of(track: Track, columns: int) -> NDArray[np.int64]:
    """Return the turns, -1, 0 or 1, by which samples of the first columns jump from the last known value."""
    found = np.zeros((len(track.times), columns), dtype=np.int64)
    for c in range(columns):
        known = np.flatnonzero(np.isfinite(track.values[:, c]))
        if len(known) < 2:
            continue
        steps = np.diff(track.values[known, c])
        sizes = np.abs(steps)
        jumps = (np.abs(sizes - TURN) < NEAR) & (sizes > SMALL * np.median(sizes))
        found[known[1:], c] = np.sign(steps) * jumps
    return found
