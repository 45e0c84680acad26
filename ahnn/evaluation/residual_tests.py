"""Tests of residuals for deviations from white noise: bias, colour, outliers, level, wrong dynamics.

Residuals of paths fitted to individual trajectories contain noise and model errors. Cross-validation over
trajectories separates them: noise is independent between trajectories, while model errors are the same
function of the state in all of them.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.data.noise_floor import NORMAL

FOLDS, RIDGE = 4, 1e-6
"""Number of cross-validation groups of trajectories; ridge of the regression, relative to mean squares."""
FAR = 4.0
"""Number of standard deviations beyond which a fraction of 6e-5 of normal values lies."""


class ResidualTests(NamedTuple):
    """Test results for each of M measured values, in standard deviations of the stated noise.

    Attributes:
        scale: (M,) robust standard deviation about the mean of each trajectory.
        explained: (M,) fraction of the variance within trajectories that a quadratic function of the state
            and of time, fitted to other trajectories, explains; 0 or less without predictive power.
        correlation: (M,) correlation of successive residuals within trajectories.
        pairs: (M,) number of pairs of successive residuals.
        bias: (M,) mean over trajectories of the trajectory means.
        bias_error: (M,) standard error of the bias, from the scatter of the trajectory means.
        spread: (M,) standard deviation of constant offsets of trajectories, minus the contribution of noise.
        spread_ratio: (M,) variance of the trajectory means, divided by their variance from noise alone.
        tails: (M,) fraction of values beyond four robust standard deviations.
        trajectories: number of trajectories.
    """

    scale: Tensor
    explained: Tensor
    correlation: Tensor
    pairs: Tensor
    bias: Tensor
    bias_error: Tensor
    spread: Tensor
    spread_ratio: Tensor
    tails: Tensor
    trajectories: int


def residual_tests(residuals: Tensor, states: Tensor, times: Tensor, unknowns: int) -> ResidualTests:
    """Test residuals for deviations from white noise.

    Args:
        residuals: (B, K, M) residuals in standard deviations; NaN where missing.
        states: (B, K, D) states of the fitted paths.
        times: (B, K) times.
        unknowns: number of fitted initial state components per trajectory.
    """
    means = residuals.nanmean(1, keepdim=True)
    within = residuals - means
    counts = (~residuals.isnan()).sum(1)
    spent = 1 + unknowns / residuals.shape[-1]
    degrees = (counts.sum(0) - spent * len(residuals)).clamp(min=1)
    variance = within.square().nansum((0, 1)) / degrees
    scale = within.abs().flatten(0, 1).nanmedian(0).values / NORMAL
    scale = scale * (counts.sum(0) / degrees).sqrt()
    products = within[:, 1:] * within[:, :-1]
    bias, differing = _of_means(means.squeeze(1))
    typical = counts.double().mean(0).clamp(min=1)
    features = _features(states, times)
    return ResidualTests(
        scale=scale,
        explained=torch.stack([_explained(part, features) for part in within.unbind(-1)]),
        correlation=products.nanmean((0, 1)) / within.square().nanmean((0, 1)) + 1 / typical,
        pairs=(~products.isnan()).sum((0, 1)),
        bias=bias,
        bias_error=(differing / len(residuals)).sqrt(),
        spread=(differing - variance / typical).clamp(min=0).sqrt(),
        spread_ratio=differing * typical / variance,
        tails=(within.abs() > FAR * scale).sum((0, 1)) / counts.sum(0).clamp(min=1),
        trajectories=len(residuals),
    )


def _of_means(means: Tensor) -> tuple[Tensor, Tensor]:
    """Return mean and variance (M,) of trajectory means (B, M)."""
    centre = means.nanmean(0)
    count = (~means.isnan()).sum(0)
    return centre, (means - centre).square().nansum(0) / (count - 1).clamp(min=1)


def _features(states: Tensor, times: Tensor) -> Tensor:
    """Return states and their products, times powers of time up to 2, minus trajectory means, (B, K, F)."""
    flat = states.flatten(0, 1)
    z = (states - flat.mean(0)) / flat.std(0).clamp(min=torch.finfo(flat.dtype).tiny)
    products = (z.unsqueeze(-1) * z.unsqueeze(-2))[..., *torch.triu_indices(z.shape[-1], z.shape[-1])]
    part = torch.cat((z, products), dim=-1)
    since = 2 * (times - times[:, :1]) / (times[:, -1:] - times[:, :1]) - 1
    powers = torch.stack((torch.ones_like(since), since, since.square()), dim=-1)
    found = (part.unsqueeze(-1) * powers.unsqueeze(-2)).flatten(-2)
    return found - found.mean(1, keepdim=True)


def _explained(residuals: Tensor, features: Tensor) -> Tensor:
    """Return the fraction of the variance of residuals (B, K) explained by cross-validated regression."""
    there = ~residuals.isnan()
    folds = min(FOLDS, len(residuals))
    if folds < 2 or int(there.sum()) < 4 * features.shape[-1]:
        return residuals.new_zeros(())  # too few for a test
    left, total = residuals.new_zeros(()), residuals.new_zeros(())
    ridge = RIDGE * torch.eye(features.shape[-1], dtype=features.dtype)
    for fold in range(folds):
        out = torch.arange(len(residuals)) % folds == fold
        a, y = features[~out][there[~out]], residuals[~out][there[~out]]
        if len(y) < features.shape[-1]:
            continue
        normal = a.mT @ a
        weights = torch.linalg.solve(normal + ridge * normal.diagonal().mean(), a.mT @ y)
        unseen = residuals[out][there[out]]
        left = left + (unseen - features[out][there[out]] @ weights).square().sum()
        total = total + unseen.square().sum()
    return 1 - left / total if total > 0 else total
