"""Thinning of curves to screen resolution, preserving spikes and the shape of orbits at periapsis."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

MOST = 720
"""Number of samples distinguishable on a screen."""


def extremes(columns: Sequence[Tensor], most: int = MOST) -> Tensor:
    """Return the indices of the samples to keep, (K,) int64, increasing, K <= most.

    Samples are divided into blocks of equal length. Each block keeps the minimum and maximum of every column,
    and one NaN, if any, so that gaps are preserved. The first and the last sample are kept.

    Args:
        columns: values (T,) at common samples.
        most: maximum number of samples, at least 2 plus 3 per column.

    Raises:
        ValueError: the maximum is too small.
    """
    count = len(columns[0])
    if count <= most:
        return torch.arange(count)
    blocks = (most - 2) // (3 * len(columns))
    if blocks < 1:
        message = (
            f"most: expected at least {3 * len(columns) + 2} for {len(columns)} columns; received {most}"
        )
        raise ValueError(message)
    length = math.ceil(count / blocks)
    rows = torch.arange(math.ceil(count / length) * length).clamp(max=count - 1).reshape(-1, length)
    ends = torch.tensor([0, count - 1])
    return torch.cat([ends, *(_marked(column, rows) for column in columns)]).unique()


def _marked(column: Tensor, rows: Tensor) -> Tensor:
    """Return the indices of the minimum, maximum and first missing sample in each row of samples (N, L)."""
    values = column[rows]
    missing = values.isnan()
    least = values.masked_fill(missing, torch.inf).argmin(1, keepdim=True)
    most = values.masked_fill(missing, -torch.inf).argmax(1, keepdim=True)
    gaps = missing.any(1)
    first = missing.to(torch.int8).argmax(1, keepdim=True)
    found = [rows.gather(1, least), rows.gather(1, most), rows[gaps].gather(1, first[gaps])]
    return torch.cat(found).flatten()


def along(points: Tensor, most: int = MOST) -> Tensor:
    """Return the indices of the samples of a path to keep, (K,) int64, increasing, K <= most.

    They are about equally spaced along the path, independent of speed: an orbit keeps its periapsis, where a
    satellite is fast and samples are sparse. Extremes of every coordinate and of the distance from the origin
    are kept, as are the first and the last sample, and one NaN per gap.

    Args:
        points: (T, n); a sample with a NaN interrupts the path.
        most: maximum number of samples, at least 8 n and 40.
    """
    count = len(points)
    if count <= most:
        return torch.arange(count)
    there = points.isfinite().all(-1)
    steps = (points[1:] - points[:-1]).norm(dim=-1).nan_to_num(0.0, 0.0, 0.0)
    length = torch.cat((steps.new_zeros(1), steps.cumsum(0)))
    columns = torch.cat((points, points.norm(dim=-1, keepdim=True)), dim=-1)
    columns = columns.masked_fill(~there[:, None], torch.nan)
    whole = torch.arange(count)[None]
    breaks = torch.nonzero(there[:-1] & ~there[1:]).flatten()[: most // 4] + 1
    kept = torch.cat([torch.tensor([0, count - 1]), breaks, *(_marked(c, whole) for c in columns.unbind(-1))])
    kept = kept.unique()
    marks = torch.linspace(0, float(length[-1]), most - len(kept), dtype=length.dtype)
    return torch.cat((kept, torch.searchsorted(length, marks).clamp(max=count - 1))).unique()
