"""Conversion of rows to trajectories: grouping by id, time order, gaps, optional cutting."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from ahnn.data.files.table import Fault, Note, Place, refuse
from ahnn.types import Trajectories

Array = NDArray[np.float64]
ON_GRID = 0.01
"""Tolerance of sample times, as a fraction of the step, for detecting a regular grid."""
APART = "a separate id (in a table) or segment (in a message)"
FILL = 20
"""Ratio of missing to present samples above which a gap separates two trajectories."""


class Track(NamedTuple):
    """Samples of one trajectory.

    Attributes:
        name: name of the trajectory.
        file: source file.
        rows: (T,) line numbers.
        times: (T,) times.
        values: (T, C) values, NaN where missing.
        controls: (T, m) controls, each valid from its sample; None without controls.
        title: name of the object besides its identifier `name`; "" if there is none.
        designator: its international designator, such as 2014-069A; "" if `name` is all that is known.
    """

    name: str
    file: str
    rows: NDArray[np.int64]
    times: Array
    values: Array
    controls: Array | None = None
    title: str = ""
    designator: str = ""

    def part(self, chosen: NDArray[Any] | slice) -> Track:
        """Return selected samples."""
        controls = None if self.controls is None else self.controls[chosen]
        parts = self.rows[chosen], self.times[chosen], self.values[chosen], controls
        return Track(self.name, self.file, *parts, self.title, self.designator)


def by_id(ids: Sequence[str], track: Track) -> list[Track]:
    """Return a track for each id, in order of first occurrence; rows may be interleaved."""
    _, first, group = np.unique(np.asarray(ids), return_index=True, return_inverse=True)
    order = np.argsort(first)
    tracks = [track.part(np.flatnonzero(group == k)) for k in order]
    return [part._replace(name=ids[int(first[k])]) for part, k in zip(tracks, order, strict=True)]


def ordered(track: Track, column: str, note: Note = refuse, spelled: Callable[[float], str] = str) -> Track:
    """Return a track with increasing times.

    Args:
        track: track as read.
        column: time column.
        note: callback for times that are missing, repeated or decreasing; such samples are then skipped.
            Times that restart from the first one count as a single fault, and only the samples before the
            restart are returned.
        spelled: function that writes a time as in the file.

    Raises:
        UserError: an error raised by `note`.
    """
    place, whose = Place(track.file, 0, column), f" of {track.name}" if track.name else ""
    for row in track.rows[np.isnan(track.times)]:
        note(Fault(place._replace(row=int(row)), "a time", "none", "Leave the row out"))
    track = track.part(np.flatnonzero(np.isfinite(track.times)))
    if len(starts := restarts(track.times)):
        k, more = int(starts[0]), f", and {len(starts) - 1} more" if len(starts) > 1 else ""
        received = f"a restart at {spelled(track.times[k])} after {spelled(track.times[k - 1])}{more}"
        row = place._replace(row=int(track.rows[k]))
        note(Fault(row, f"increasing times{whose}", received, f"Give each trajectory {APART}"))
        track = track.part(slice(0, k))
    late = np.maximum.accumulate(track.times)
    good = np.concatenate(([True], track.times[1:] > late[:-1])) if len(late) else np.zeros(0, dtype=bool)
    last = np.maximum.accumulate(np.where(good, np.arange(len(late)), 0))
    for k in np.flatnonzero(~good):
        before, here, known = spelled(late[k - 1]), spelled(track.times[k]), track.rows[last[k]]
        row = place._replace(row=int(track.rows[k]))
        if late[k - 1] == track.times[k]:
            equal = np.array_equal(track.values[k], track.values[last[k]], equal_nan=True)
            remedy = "Remove the repeated row" if equal else f"Give each trajectory {APART}"
            note(Fault(row, f"each time{whose} once", f"{here}, which duplicates row {known}", remedy))
        else:
            note(
                Fault(row, f"a time{whose} after {before} in row {known}", f"{here}", "Sort the rows by time")
            )
    return track.part(good)


def restarts(times: Array) -> NDArray[np.int64]:
    """Return the samples at which times fall back to the first time, within half a median step.

    Such rows contain several trajectories. The result is empty if times also fall back elsewhere, or if one
    of the trajectories is a single sample.
    """
    steps = np.diff(times)
    found = np.flatnonzero(steps < 0) + 1
    if not (steps > 0).any():
        return found[:0]
    near = np.abs(times[found] - times[0]) <= 0.5 * np.median(steps[steps > 0])
    lengths = np.diff(np.concatenate(([0], found, [len(times)])))
    return found if near.all() and lengths.min() > 1 else found[:0]


def filled(track: Track, gap: float, *, linear: bool = False) -> Track:
    """Fill the gaps of a track with missing samples, at about the spacing of the existing ones.

    On a regular grid every missing point is a gap; otherwise, every step longer than `gap` times the median
    step is one. Controls continue through a gap, held or interpolated linearly.

    Raises:
        UserError: a gap long enough to separate two trajectories.
    """
    if len(track.times) < 3:
        return track
    ratio, on_grid = steps_in_medians(track.times)
    counts = np.where(ratio > (1.5 if on_grid else gap), np.round(ratio), 1.0)
    if not counts.sum() <= FILL * len(track.times):
        k = int(counts.argmax())
        Place(track.file, int(track.rows[k + 1])).refuse(
            f"gaps with at most {FILL} missing samples per existing sample",
            f"one of {counts[k]:.15g} steps",
            f"Give the samples on either side {APART}",
        )
    ends = np.concatenate(([0], counts.astype(np.int64).cumsum()))
    times = np.interp(np.arange(ends[-1] + 1), ends, track.times)
    values = np.full((len(times), track.values.shape[1]), np.nan)
    rows = np.zeros(len(times), dtype=np.int64)
    times[ends], values[ends], rows[ends] = track.times, track.values, track.rows
    controls = track.controls
    if controls is not None and linear:
        columns = [np.interp(times, track.times, column) for column in controls.T]
        controls = np.stack(columns, axis=1)
    elif controls is not None:
        controls = controls[np.searchsorted(ends, np.arange(len(times)), side="right") - 1]
    return track._replace(rows=rows, times=times, values=values, controls=controls)


def steps_in_medians(times: Array) -> tuple[Array, bool]:
    """Return the steps of times (T,) divided by their median, and whether all are about whole numbers."""
    steps = np.diff(times)
    ratio = steps / np.median(steps)
    whole = np.round(ratio)
    return ratio, bool((np.abs(ratio - whole) <= ON_GRID * whole).all())


def cut_for_splits(samples: int) -> str:
    """Return the option that cuts a single trajectory into about ten; empty if it is too short."""
    return f"system.cut={max(20, samples // 10)}" if samples >= 60 else ""


def cut(track: Track, samples: int | None) -> list[Track]:
    """Cut a track into segments of about equal length, near `samples`; None: not cut."""
    count = 1 if samples is None else max(1, round(len(track.times) / samples))
    return [track.part(part) for part in np.array_split(np.arange(len(track.times)), count)]


def trimmed(track: Track, *, partly: bool = False) -> Track:
    """Trim a track to the range from its first to its last complete (or partly known) sample."""
    there = np.isfinite(track.values)
    chosen = np.flatnonzero(there.any(1) if partly else there.all(1))
    return track.part(slice(chosen[0], chosen[-1] + 1) if len(chosen) else slice(0))


def stacked(tracks: Sequence[Track], *, linear: bool = False) -> Trajectories:
    """Stack tracks as trajectories, padding shorter ones with NaN."""
    longest = max(len(track.times) for track in tracks)
    times = torch.full((len(tracks), longest), math.nan, dtype=torch.float64)
    states = torch.full((len(tracks), longest, tracks[0].values.shape[1]), math.nan, dtype=torch.float64)
    size = 0 if tracks[0].controls is None else tracks[0].controls.shape[1]
    controls = torch.full((len(tracks), longest, size), math.nan, dtype=torch.float64)
    for b, track in enumerate(tracks):
        times[b, : len(track.times)] = torch.from_numpy(track.times)
        states[b, : len(track.times)] = torch.from_numpy(track.values)
        if track.controls is not None:
            controls[b, : len(track.times)] = torch.from_numpy(track.controls)
    return Trajectories(states, times, controls if size else None, linear)
