"""What float64 leaves of sigma points that lie close together.

The points lie r = alpha sqrt(D + kappa) standard deviations from the mean. The mean of their images y is
formed from differences, each of which is rounded to eps |y|, with weights that sum to D / r²: it is off by
about

    (D / r²) eps |y|.

For alpha = 1e-3 that is a millionth of a standard deviation where |y| is 5,000 of them; for alpha = 1e-7 it
is 100 standard deviations. A member for which it exceeds `LIMIT` of them gets a status and stops. What a flow
or a measurement model rounds by itself, for instance in float32, comes on top and is not known here.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.consistency import deviations
from ahnn.estimation.linalg import EPS
from ahnn_plugins.ukf.types import Weights

LIMIT = 1e-3
"""Fraction of a standard deviation that rounding may cost in one prediction or update."""


def lost_in_rounding(before: Belief, after: Belief, weights: Weights) -> Tensor:
    """Return for which members rounding in a step from one belief to another exceeds the limit, (B,) bool."""
    ratios = [(b.mean.detach().abs() / deviations(b.chol.detach())).amax(-1) for b in (before, after)]
    return _exceeds(torch.maximum(*ratios), weights)


def images_lost_in_rounding(images: Tensor, present: Tensor, chol_r: Tensor, weights: Weights) -> Tensor:
    """Return for which members rounding of predicted measurements exceeds the limit, (B,) bool.

    In standard deviations of the noise: where it is small against the prior, it is what the posterior keeps
    of an error of the prediction.

    Args:
        images: (B, S, M) measurements of the points.
        present: (B, M) bool, components that are there.
        chol_r: (B, M, M) factor of R.
        weights: of the points.
    """
    ratio = images[:, 0].detach().abs() / deviations(chol_r.detach())
    return _exceeds(torch.where(present, ratio, 0.0).amax(-1), weights)


def _exceeds(ratio: Tensor, weights: Weights) -> Tensor:
    crowding = 0.0 if weights.crowding is None else weights.crowding.flatten()
    return EPS * crowding * ratio > LIMIT
