"""Error metrics of predicted trajectories: two definitions of RMSE, energy error, moving averages.

Samples whose truth is NaN are ignored. A non-finite prediction of a finite truth has infinite error; it is
never omitted from a mean.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Scores(NamedTuple):
    """Errors of a set of predicted trajectories, in the system's units.

    Attributes:
        position, velocity: mean over trajectories of the root mean square over time of the vector norm;
            the definition that best fits the paper's numbers.
        position_pooled, velocity_pooled: root mean square over trajectories, times and components.
        energy: root mean square over trajectories and times of H(prediction) - H(truth), with the true H;
            None if H is unknown.
        components: (D,) root mean square of each component, velocities in place of momenta.
    """

    position: float
    velocity: float
    position_pooled: float
    velocity_pooled: float
    energy: float | None
    components: tuple[float, ...]


def errors(prediction: Tensor, truth: Tensor) -> Tensor:
    """Return prediction - truth, shape (B, T, D); inf for non-finite predictions, NaN without truth."""
    difference = prediction - truth
    lost = ~prediction.isfinite() & truth.isfinite()
    return difference.masked_fill(lost, torch.inf)


def rmse_pooled(error: Tensor) -> Tensor:
    """Return the root mean square over all valid entries as a scalar."""
    return error.square().nanmean().sqrt()


def rmse_norm(error: Tensor) -> Tensor:
    """Return the mean over trajectories of the rms over time of the vector norm, a scalar.

    Args:
        error: (B, T, n), rows are NaN where there is no truth; trajectories without any truth are ignored.
    """
    return error.square().sum(-1).nanmean(-1).sqrt().nanmean()


def typical_error(error: Tensor, ceiling: float) -> Tensor:
    """Return the geometric mean over time of the rms over trajectories of the vector norm, a scalar.

    It still distinguishes models whose predictions diverge from the truth: it decreases when they stay close
    for longer, whereas a root mean square reflects only their final distance.

    Args:
        error: (B, T, n) with NaN rows after the end of a trajectory.
        ceiling: error beyond which a prediction is useless; larger and infinite errors are set to it.
    """
    norm = error.square().sum(-1).nanmean(0).sqrt()
    norm = norm[~norm.isnan()].clamp(min=torch.finfo(norm.dtype).tiny, max=ceiling)
    return norm.log().mean().exp()


def score(
    prediction: Tensor, truth: Tensor, energies: tuple[Tensor, Tensor] | None, inertia: float | Tensor
) -> Scores:
    """Compute all scores.

    Args:
        prediction: (B, T, D).
        truth: (B, T, D), NaN without truth.
        energies: true Hamiltonian of prediction and of truth, each (B, T); None if H is unknown.
        inertia: divisor of momenta that gives velocities, a number or (n,).
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

    NaN values are ignored; the mean is NaN for a window of only NaN and after the last value, and inf for a
    window with an inf.
    """
    there, lost = ~series.isnan(), series.isinf()
    values = series.masked_fill(~there | lost, 0.0)
    sums, counts, infinite = (_trailing(x.to(series.dtype), width) for x in (values, there, lost))
    ended = there.flip(0).cumsum(0).flip(0) == 0
    return (sums / counts).masked_fill(infinite > 0, torch.inf).masked_fill(ended, torch.nan)


def _trailing(x: Tensor, width: int) -> Tensor:
    """Return the sums over the last min(k, width) values, shape (T,)."""
    sums = torch.cat((x.new_zeros(1), x.cumsum(0)))
    last = torch.arange(1, len(x) + 1)
    return sums[last] - sums[(last - width).clamp(min=0)]
