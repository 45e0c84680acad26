"""Curves thinned to what a screen shows: spikes survive, and so does the shape of an orbit at periapsis."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

MOST = 720
"""Samples of a curve that a screen tells apart."""


def extremes(columns: Sequence[Tensor], most: int = MOST) -> Tensor:
    """Return the numbers of the samples to keep, (K,) int64, increasing, K <= most.

    The samples are cut into stretches of equal length. Each keeps the least and the greatest value of every
    column, and one NaN if it has any, so that an interruption stays one. The first and the last sample stay.

    Args:
        columns: values (T,) that share their samples.
        most: samples to keep, at least 4 and 3 for each column besides.

    Raises:
        ValueError: so few samples cannot be kept.
    """
    count = len(columns[0])
    if count <= most:
        return torch.arange(count)
    stretches = (most - 2) // (3 * len(columns))
    if stretches < 1:
        message = f"most: expected at least {3 * len(columns) + 2} of {len(columns)} columns; received {most}"
        raise ValueError(message)
    edges = torch.linspace(0, count, stretches + 1).round().long().tolist()
    kept = {0, count - 1}
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        for column in columns:
            kept |= {first + k for k in _marked(column[first:last])}
    return torch.tensor(sorted(kept))


def _marked(values: Tensor) -> set[int]:
    """Return where the least, the greatest and the first missing of some values stand."""
    missing = values.isnan()
    found = {int(missing.long().argmax())} if bool(missing.any()) else set()
    if bool((~missing).any()):
        found.add(int(values.masked_fill(missing, torch.inf).argmin()))
        found.add(int(values.masked_fill(missing, -torch.inf).argmax()))
    return found


def along(points: Tensor, most: int = MOST) -> Tensor:
    """Return the numbers of the samples of a path to keep, (K,) int64, increasing, K <= most.

    They are about equally far apart along the path, whatever the speed: an orbit keeps its periapsis, where a
    satellite is fast and its samples are few. The extremes of every coordinate and of the distance from the
    origin stay, and so do the first and the last sample, and one NaN of each interruption.

    Args:
        points: (T, n); a sample with a NaN interrupts the path.
        most: samples to keep.
    """
    count = len(points)
    if count <= most:
        return torch.arange(count)
    there = points.isfinite().all(-1)
    steps = (points[1:] - points[:-1]).norm(dim=-1).nan_to_num(0.0, 0.0, 0.0)
    length = torch.cat((steps.new_zeros(1), steps.cumsum(0)))
    columns = torch.cat((points, points.norm(dim=-1, keepdim=True)), dim=-1).masked_fill(
        ~there[:, None], torch.nan
    )
    kept = {0, count - 1}.union(*(_marked(column) for column in columns.unbind(-1)))
    breaks = torch.nonzero(there[:-1] & ~there[1:]).flatten() + 1
    kept |= set(breaks[: most // 4].tolist())
    marks = torch.linspace(0, float(length[-1]), max(most - len(kept), 2), dtype=length.dtype)
    kept |= set(torch.searchsorted(length, marks).clamp(max=count - 1).tolist()[: most - len(kept)])
    return torch.tensor(sorted(kept))
