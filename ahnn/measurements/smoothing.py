"""States and rates from noisy measurements, by local polynomials in time.

No dynamics are needed; the results provide scalings and initial values of fits.
"""

from __future__ import annotations

from typing import NamedTuple, NoReturn, cast

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.measurements.base import Locating
from ahnn.measurements.segment import Instrument, Segment

DEGREE = 3
"""Degree of the polynomials (Savitzky & Golay 1964, for samples at arbitrary times)."""
FIRST = 6
"""Number of samples for an initial guess."""
WIDTHS = (2, 3, 5, 8, 12, 18, 27, 40, 60, 90)
"""Candidate numbers of samples on either side."""


class Local(NamedTuple):
    """Local polynomials at selected times, with C components each.

    Attributes:
        value, rate, curvature: (E, C) value at the centre, and first and second derivatives.
        rate_sd, curvature_sd: (E, C) standard deviations of the derivatives, from the scatter of the samples.
        error: (E, C) difference of the central sample from the polynomial through all other samples.
        width: number of fitted samples on either side.
        chosen: (E, 2) row and column of the central samples; None for the first samples of segments.
    """

    value: Tensor
    rate: Tensor
    curvature: Tensor
    rate_sd: Tensor
    curvature_sd: Tensor
    error: Tensor
    width: int = 0
    chosen: Tensor | None = None


def local_polynomials(values: Tensor, offsets: Tensor, middle: int, degree: int = DEGREE) -> Local:
    """Fit polynomials, at most cubic, to samples.

    Args:
        values: (E, R, C) samples; samples with NaN are ignored.
        offsets: (E, R) times relative to the evaluation time.
        middle: index of the central sample.
        degree: degree of the polynomials, at most DEGREE.
    """
    there = values.isfinite().all(-1) & offsets.isfinite()
    offsets, values = offsets.masked_fill(~there, 0), values.masked_fill(~there.unsqueeze(-1), 0)
    scale = offsets.abs().amax(1, keepdim=True).clamp(min=torch.finfo(offsets.dtype).tiny)
    powers = torch.arange(DEGREE + 1).to(offsets)
    design = (offsets / scale).unsqueeze(-1) ** powers
    design = design * (there.unsqueeze(-1) & (powers <= degree))
    solver = torch.linalg.pinv(design)
    coefficients = solver @ values
    leverage = solver[:, 0, middle]
    left = (values[:, middle] - coefficients[:, 0]) / (1 - leverage).clamp(min=1e-6).unsqueeze(-1)
    spare = (there.sum(1) - degree - 1).clamp(min=1).unsqueeze(-1)
    scatter = ((values - design @ coefficients).square().sum(1) / spare).sqrt()
    sds = scatter.unsqueeze(1) * solver.norm(dim=-1, keepdim=True)  # of the coefficients
    return Local(
        coefficients[:, 0],
        coefficients[:, 1] / scale,
        2 * coefficients[:, 2] / scale**2,
        sds[:, 1] / scale,
        2 * sds[:, 2] / scale**2,
        left,
    )


def guess(segment: Segment) -> Tensor:
    """Estimate initial states (B, 2n) from the first samples of each segment."""
    instrument = segment.instrument
    first = segment.first(FIRST - 1)
    located = located_at(instrument, first.values, first.times)
    local = local_polynomials(located, first.times - first.times[:, :1], 0)
    return as_states(local.value, local.rate, instrument)


def located_at(instrument: Instrument, values: Tensor, times: Tensor) -> Tensor:
    """Return positions (..., n) or states (..., 2n) estimated from measurements (..., M)."""
    located = cast(Locating, instrument.measurement).locate(values, times)
    return located[..., : instrument.dof] if instrument.sparse_momenta else located


def momenta_are_sparse(instrument: Instrument, values: Tensor, times: Tensor) -> bool:
    """Return whether fewer states than an initial guess requires, of all measured positions, have momenta."""
    located = located_at(instrument, values, times).isfinite()
    positions = located[..., : instrument.dof].all(-1).sum()
    return bool(located.all(-1).sum() * FIRST < positions * (DEGREE + 1))


def as_states(value: Tensor, rate: Tensor, instrument: Instrument) -> Tensor:
    """Return states (..., 2n) from positions and velocities, or states unchanged."""
    whole = value.shape[-1] == 2 * instrument.dof
    return value if whole else torch.cat((value, instrument.inertia * rate), dim=-1)


def smoothed(instrument: Instrument, values: Tensor, times: Tensor, count: int, seed: int = 0) -> Local:
    """Fit polynomials at about `count` samples, with the width that best predicts left-out samples.

    Args:
        instrument: instrument of the measurements.
        values: (B, T, M) measurements.
        times: (B, T) times.
        count: approximate number of samples.
        seed: seed of the random selection.

    Raises:
        UserError: no sample has enough neighbours.
    """
    rows = located_at(instrument, values, times).isfinite().all(-1).nonzero()
    draw = torch.randperm(len(rows), generator=torch.Generator().manual_seed(seed))[:count]
    chosen = rows[draw]
    best, least = None, torch.inf
    for width in WIDTHS:
        if width > FIRST and 2 * width + 1 > values.shape[1]:
            break
        local = around(instrument, values, times, chosen, width)
        if not len(local.error):
            continue
        size = float((local.error / scale_of(local)).square().median(0).values.sum())
        if size < least:
            best, least = local._replace(width=width), size
    return best or no_start(times)


def no_start(times: Tensor) -> NoReturn:
    """Raise UserError for measurements at times (B, T) too sparse to determine any initial state."""
    rows, samples = times.shape
    message = (
        f"data: expected trajectories with at least {DEGREE + 1} of {FIRST} consecutive measurements of the "
        f"position or state, which determine an initial state; received {rows} trajectories of {samples} "
        "times each, none of which has them. Measure more often"
    )
    raise UserError(message)


def scale_of(local: Local) -> Tensor:
    """Return the spread of each component, (C,), or 1 for constant components."""
    spread = local.value.std(0)
    return torch.where(spread > 0, spread, torch.ones_like(spread))


def around(instrument: Instrument, values: Tensor, times: Tensor, chosen: Tensor, width: int) -> Local:
    """Fit polynomials to `width` samples on either side of chosen ones, (E, 2) row and column.

    Samples with too few neighbours, such as the only one of a pass, are omitted. The degree is reduced for
    trajectories too short for a cubic.
    """
    degree = min(DEGREE, max(0, values.shape[1] - 2))
    offsets = torch.arange(-width, width + 1)
    columns = chosen[:, 1:] + offsets
    inside = (columns >= 0) & (columns < values.shape[1])
    columns = columns.clamp(0, values.shape[1] - 1)
    there = times[chosen[:, :1], columns].masked_fill(~inside, torch.nan)
    located = located_at(instrument, values[chosen[:, :1], columns], there.nan_to_num())
    middle = times[chosen[:, 0], chosen[:, 1]].unsqueeze(-1)
    enough = (located.isfinite().all(-1) & inside).sum(1) > degree + 1
    local = local_polynomials(located[enough], (there - middle)[enough], width, degree)
    return local._replace(chosen=chosen[enough])
