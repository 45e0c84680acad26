"""Scores of predicted trajectories: two definitions of RMSE, energy, moving averages.

Truth that is NaN marks samples that do not count. A prediction that is not finite where the truth is counts
as infinitely wrong; it never drops out of a mean.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Scores(NamedTuple):
    """Errors of a set of predicted trajectories, in the units of the system.

    Attributes:
        position, velocity: mean over trajectories of the root mean square over time of the vector norm;
            the definition that the paper's numbers fit best.
        position_pooled, velocity_pooled: root mean square over trajectories, times and components.
        energy: root mean square over trajectories and times of H(prediction) - H(truth), with the true H;
            None where that is not known.
        components: (D,) root mean square of each component, velocities in place of momenta.
    """

    position: float
    velocity: float
    position_pooled: float
    velocity_pooled: float
    energy: float | None
    components: tuple[float, ...]


def errors(prediction: Tensor, truth: Tensor) -> Tensor:
    """Return prediction - truth, shape (B, T, D); inf where the prediction is lost, NaN beyond the truth."""
    difference = prediction - truth
    lost = ~prediction.isfinite() & truth.isfinite()
    return difference.masked_fill(lost, torch.inf)


def rmse_pooled(error: Tensor) -> Tensor:
    """Return the root mean square over all valid entries, a scalar."""
    return error.square().nanmean().sqrt()


def rmse_norm(error: Tensor) -> Tensor:
    """Return the mean over trajectories of the rms over time of the vector norm, a scalar.

    Args:
        error: (B, T, n) with NaN rows where there is no truth; a trajectory without any does not count.
    """
    return error.square().sum(-1).nanmean(-1).sqrt().nanmean()


def typical_error(error: Tensor, ceiling: float) -> Tensor:
    """Return the geometric mean over time of the rms over trajectories of the vector norm, a scalar.

    It still tells models apart whose predictions leave the truth altogether: it falls when they stay near for
    longer, where a root mean square says only how far away they end.

    Args:
        error: (B, T, n) with NaN rows where a trajectory has ended.
        ceiling: an error beyond which a prediction is lost; larger ones, and inf, count as this.
    """
    norm = error.square().sum(-1).nanmean(0).sqrt()
    norm = norm[~norm.isnan()].clamp(min=torch.finfo(norm.dtype).tiny, max=ceiling)
    return norm.log().mean().exp()


def score(
    prediction: Tensor, truth: Tensor, energies: tuple[Tensor, Tensor] | None, inertia: float | Tensor
) -> Scores:
    """Return all scores.

    Args:
        prediction: (B, T, D).
        truth: (B, T, D), NaN where there is none.
        energies: true Hamiltonian of prediction and of truth, each (B, T); None where it is not known.
        inertia: momenta are divided by it to give velocities, (n,) where it differs.
    """
    error = errors(prediction, truth)
    position, momentum = error.chunk(2, dim=-1)
    velocity = momentum / inertia
    components = torch.cat((position, velocity), dim=-1).flatten(0, 1).square().nanmean(0).sqrt()
    return Scores(
        position=float(rmse_norm(position)),
        velocity=float(rmse_norm(velocity)),
        position_pooled=float(rmse_pooled(position)),
        velocity_pooled=float(rmse_pooled(velocity)),
        energy=None if energies is None else float(rmse_pooled(errors(*energies))),
        components=tuple(components.tolist()),
    )


def moving_average(series: Tensor, width: int) -> Tensor:
    """Return the trailing mean over the last min(k, width) values, shape (T,) (paper, appendix).

    NaN values do not count; where a window holds nothing else the mean is NaN. It is inf where a window
    holds an inf.
    """
    there, lost = ~series.isnan(), series.isinf()
    values = series.masked_fill(~there | lost, 0.0)
    sums, counts, infinite = (_trailing(x.to(series.dtype), width) for x in (values, there, lost))
    return (sums / counts).masked_fill(infinite > 0, torch.inf)


def _trailing(x: Tensor, width: int) -> Tensor:
    """Return the sums over the last min(k, width) values, shape (T,)."""
    sums = torch.cat((x.new_zeros(1), x.cumsum(0)))
    last = torch.arange(1, len(x) + 1)
    return sums[last] - sums[(last - width).clamp(min=0)]
