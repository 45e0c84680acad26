"""Data leakage: samples that occur in two trajectories, which would invalidate a test."""

from __future__ import annotations

import numpy as np
import torch
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ahnn.data.doctor.finding import Finding
from ahnn.data.files.samples import Track
from ahnn.data.fingerprints import fingerprints

RUN = 8
"""Minimum number of equal consecutive samples (or a complete trajectory): a few may be equal by chance."""
LEAST = 3
"""Minimum number of samples of a trajectory that is compared."""


def leakage_findings(tracks: list[Track]) -> list[Finding]:
    """Find where trajectories, of one or several files, begin to share identical samples.

    Args:
        tracks: tracks of all files.
    """
    keys = [runs(track) for track in tracks]
    flat = np.concatenate(keys) if keys else np.zeros(0, dtype=np.int64)
    owner = np.repeat(np.arange(len(keys)), [len(key) for key in keys])
    place = np.concatenate([np.arange(len(key)) for key in keys]) if keys else owner
    order = np.lexsort((owner, flat))
    flat, owner, place = flat[order], owner[order], place[order]
    again = np.flatnonzero((flat[1:] == flat[:-1]) & (owner[1:] != owner[:-1]) & (flat[1:] != 0)) + 1
    firsts: dict[tuple[int, int], tuple[int, int]] = {}
    for k in again.tolist():
        pair, here = (int(owner[k - 1]), int(owner[k])), (int(place[k]), int(place[k - 1]))
        firsts[pair] = min(firsts.get(pair, here), here)
    return [finding(tracks[a], tracks[b], *firsts[a, b]) for a, b in firsts]


def finding(one: Track, other: Track, at: int, first: int) -> Finding:
    """Build the finding that a track repeats samples of another."""
    name = f" of trajectory {one.name}" if one.name else ""
    what = f"this and later samples repeat the samples from row {one.rows[first]} of {one.file}{name}"
    return Finding("fault", other.file, int(other.rows[at]), "", what, "Keep one of the two trajectories")


def runs(track: Track) -> NDArray[np.int64]:
    """Return a key for each run of samples; 0 for constant samples or missing values."""
    values = np.ascontiguousarray(track.values)
    if len(values) < LEAST:
        return np.zeros(0, dtype=np.int64)
    windows = sliding_window_view(values, min(RUN, len(values)), axis=0)
    constant, lost = (windows == windows[..., :1]).all((1, 2)), np.isnan(windows).any((1, 2))
    return np.where(constant | lost, 0, fingerprints(torch.from_numpy(values)[None], RUN)[0].numpy())
