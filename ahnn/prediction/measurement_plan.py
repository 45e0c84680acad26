"""Measurements that lower the variance of a forecast most, chosen before any measurement is made.

To first order, the information of a measurement does not depend on its value. The unknowns are independent
and have unit variance; they correspond to the columns of covariance factors. The candidate that lowers the
trace of the forecast's covariance most is added, one at a time; then single measurements are exchanged as
long as this lowers the trace further (Fedorov 1972, Theory of Optimal Experiments, chapter 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

SWEEPS = 10
"""Maximum number of times that each measurement is exchanged."""
MARGIN = 1e-6
"""Minimum relative gain of an exchange, above rounding errors."""


class MeasurementPlan(NamedTuple):
    """Candidates in the order of their choice.

    Attributes:
        chosen: indices of C candidates.
        variances: (C + 1,) trace of the forecast's covariance before the first and after each measurement.
    """

    chosen: list[int]
    variances: Tensor


@torch.no_grad()
def plan_measurements(candidates: Sequence[Tensor], forecast: Tensor, count: int) -> MeasurementPlan:
    """Choose measurements until no exchange of one of them improves the plan; best first.

    Args:
        candidates: for each, the derivatives (K, R) of its K measurements with respect to the unknowns,
            divided by their standard deviations.
        forecast: (G, R) derivative of the predicted values.
        count: maximum number of measurements to choose.
    """
    rows, everything = list(candidates), range(len(candidates))
    chosen, _ = _one_by_one(rows, forecast, everything, count)
    for _ in range(SWEEPS):
        before = list(chosen)
        for place in range(len(chosen)):
            others = chosen[:place] + chosen[place + 1 :]
            left = [k for k in everything if k not in others]
            known = torch.cat([rows[k] for k in others]) if others else forecast[:0]
            *free, moved = _informed([*(rows[k] for k in left), forecast], known)
            gains = [_reduction(one, moved) for one in free]
            best = max(range(len(left)), key=gains.__getitem__)
            if gains[best] > (1 + MARGIN) * gains[left.index(chosen[place])]:
                chosen[place] = left[best]
        if chosen == before:
            break
    return MeasurementPlan(*_one_by_one(rows, forecast, chosen, count))


def _one_by_one(
    rows: list[Tensor], forecast: Tensor, among: Sequence[int], count: int
) -> tuple[list[int], Tensor]:
    """Choose candidates one by one, each the best addition to earlier ones; also return the variances."""
    chosen, variances = [], [_trace(forecast)]
    for _ in range(min(count, len(among))):
        left = [k for k in among if k not in chosen]
        chosen.append(max(left, key=lambda k: _reduction(rows[k], forecast)))
        *rows, forecast = _informed([*rows, forecast], rows[chosen[-1]])
        variances.append(_trace(forecast))
    return chosen, torch.stack(variances)


@torch.no_grad()
def variance_with(candidates: Sequence[Tensor], forecast: Tensor) -> Tensor:
    """Return the trace of a forecast's covariance after given measurements, see `plan_measurements`."""
    return _trace(_informed([forecast], torch.cat(list(candidates)))[0])


def evenly_spaced(candidates: int, count: int) -> list[int]:
    """Return the indices of `count` candidates, ordered in time and spaced as evenly as possible."""
    return torch.linspace(0, candidates - 1, count).round().long().unique().tolist()


def _trace(factor: Tensor) -> Tensor:
    return factor.square().sum()


def _reduction(rows: Tensor, forecast: Tensor) -> float:
    """Return the decrease of the trace of the forecast's covariance due to measurements."""
    root = _root_of_one_more(rows)
    return float(_trace(torch.linalg.solve_triangular(root, rows @ forecast.mT, upper=False)))


def _informed(parts: Sequence[Tensor], rows: Tensor) -> list[Tensor]:
    """Transform derivatives to unknowns that have unit variance after measurements with `rows` (K, R)."""
    root = _root_of_one_more(rows.mT)
    return [torch.linalg.solve_triangular(root, part.mT, upper=False).mT for part in parts]


def _root_of_one_more(rows: Tensor) -> Tensor:
    """Return L, lower triangular, with L L^T = 1 + A A^T for A of shape (K, R).

    A is not squared: the one would be lost beside variances of 1e16 and more.
    """
    return torch.linalg.qr(torch.cat((torch.eye(len(rows)).to(rows), rows.mT)), mode="r").R.mT
