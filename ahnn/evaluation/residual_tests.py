"""What residuals contain beside white noise: bias, colour, outliers, a wrong size, or errors of the dynamics.

Residuals are those of paths fitted to trajectories one by one: they contain the noise and what the dynamics
cannot describe. Other trajectories tell the two apart: their noise is new, but dynamics that are wrong are
wrong by the same function of the state.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.data.noise_floor import NORMAL

FOLDS, RIDGE = 4, 1e-6
"""Groups of trajectories that are left out in turn; ridge of the regression, relative to mean squares."""
FAR = 4.0
"""Standard deviations beyond which 6e-5 of normal numbers lie."""


class ResidualTests(NamedTuple):
    """Findings for each of M measured numbers, in standard deviations of the stated noise.

    Attributes:
        scale: (M,) robust standard deviation about the mean of each trajectory.
        explained: (M,) fraction of the variance within trajectories that a quadratic function of the state
            and of time, fitted to other trajectories, explains; 0 or less where it explains nothing.
        correlation: (M,) of neighbours within trajectories.
        pairs: (M,) how many neighbours there were.
        bias: (M,) mean over trajectories of their means.
        bias_error: (M,) its standard error, from how trajectories differ.
        spread: (M,) standard deviation of what is constant in a trajectory, beyond what noise leaves.
        spread_ratio: (M,) variance of the means of trajectories over that of means of the noise.
        tails: (M,) fraction of the numbers beyond four robust standard deviations.
        trajectories: how many there were.
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
    """Return what residuals have beside white noise.

    Args:
        residuals: (B, K, M) in standard deviations; NaN where nothing was measured.
        states: (B, K, D) of the fitted paths.
        times: (B, K).
        unknowns: numbers of the start that each trajectory was fitted with.
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
    """Return mean and variance (M,) of means (B, M) of trajectories."""
    centre = means.nanmean(0)
    count = (~means.isnan()).sum(0)
    return centre, (means - centre).square().nansum(0) / (count - 1).clamp(min=1)


def _features(states: Tensor, times: Tensor) -> Tensor:
    """Return states and products, also times powers of time, (B, K, F), less their means in each row."""
    flat = states.flatten(0, 1)
    z = (states - flat.mean(0)) / flat.std(0).clamp(min=torch.finfo(flat.dtype).tiny)
    products = (z.unsqueeze(-1) * z.unsqueeze(-2))[..., *torch.triu_indices(z.shape[-1], z.shape[-1])]
    part = torch.cat((z, products), dim=-1)
    since = 2 * (times - times[:, :1]) / (times[:, -1:] - times[:, :1]) - 1
    powers = torch.stack((torch.ones_like(since), since, since.square()), dim=-1)
    found = (part.unsqueeze(-1) * powers.unsqueeze(-2)).flatten(-2)
    return found - found.mean(1, keepdim=True)


def _explained(residuals: Tensor, features: Tensor) -> Tensor:
    """Return by which fraction a regression on other trajectories lowers the variance of residuals (B, K)."""
    there = ~residuals.isnan()
    folds = min(FOLDS, len(residuals))
    if folds < 2 or int(there.sum()) < 4 * features.shape[-1]:
        return residuals.new_zeros(())  # too few to tell
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
