"""Series from arrays: thinned to screen resolution, with gaps for undrawable values."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.evaluation.style import LOST
from ahnn_plugins.report.drawing import Role, Series
from ahnn_plugins.report.thinning import along, extremes

Band = tuple[Tensor, Tensor]
"""Lower and upper edge of a band, each (T,)."""


def curve(
    label: str,
    x: Tensor,
    y: Tensor,
    *,
    role: Role = "model",
    slot: int = 0,
    band: Band | None = None,
    log: bool = False,
) -> Series:
    """Return a curve over time, (T,), preserving spikes; non-positive values are gaps on a log axis."""
    columns = [drawable(part, log=log) for part in (y, *(band or ()))]
    at = extremes(columns)
    low, high = (column[at] for column in columns[1:]) if band else (None, None)
    return Series(label, x[at], columns[0][at], role=role, slot=slot, low=low, high=high)


def path(
    label: str,
    points: Tensor,
    *,
    role: Role = "model",
    slot: int = 0,
    hover: dict[str, Tensor] | None = None,
) -> Series:
    """Return a path through the points (T, 2) or (T, 3), with about uniform density."""
    points = drawable(points)
    at = along(points)
    x, y, *z = points[at].unbind(-1)
    shown = {name: values[at] for name, values in (hover or {}).items()}
    return Series(label, x, y, z[0] if z else None, role, slot, hover=shown)


def drawable(values: Tensor, *, log: bool = False) -> Tensor:
    """Return values with NaN in place of those that an axis cannot show."""
    there = values.abs() < LOST
    return values.masked_fill(~(there & (values > 0) if log else there), torch.nan)


def cut(points: Tensor, truth: Tensor, times: float = 3.0) -> Tensor:
    """Return points (T, n) with NaN from the first one far from the truth.

    The limit is `times` the extent of the truth in each coordinate, from its centre, so that a diverged
    prediction does not shrink all other curves to a dot. With missing points, only distant ones become NaN.
    """
    known = truth[truth.isfinite().all(-1)]
    if not len(known):
        return points
    low, high = known.amin(0), known.amax(0)
    size = (high - low).clamp(min=torch.finfo(truth.dtype).tiny)
    away = ((points - (low + high) / 2) / size).abs().amax(-1)
    lost = ~(away <= times)
    lost = lost.cumsum(0) > 0 if bool(points.isfinite().all()) else lost
    return points.masked_fill(lost[:, None], torch.nan)
