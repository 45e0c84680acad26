"""How much noise samples have, read off their differences of high order, before anything is trained."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.statistics import sampling_interval
from ahnn.types import Trajectories

ORDERS = (8, 9, 10)
"""Of the differences: a smooth motion is gone from them, unless it is sampled too rarely."""
PLATEAU = 0.2
"""Change from one order to the next beyond which it is the motion that is seen."""
NORMAL = 0.6745
"""Median absolute value of a standard normal number."""
LOW, LOW_NORMAL = 0.2, 0.2533
"""A share of the differences that few outliers reach, and what bounds it of standard normal ones."""
FAR = 6.0
"""Standard deviations of a difference beyond which what it is centred on does not count."""
SHARE = 1e-4
"""Noise in increments from which objectives that compare windows of samples learn it."""
LOOKED_AT = 2**18
"""Samples of which medians are sharp enough, to half a per cent."""
TWICE = 2.0
"""Factor by which stated and found noise may differ without a word."""


def noise_floor(trajectories: Trajectories) -> Tensor:
    """Return the standard deviation of the noise of each component, (D,); NaN where it cannot be told.

    The k-th difference of independent noise has the variance (2k over k) sigma^2, and of a smooth motion
    goes to zero with k. Medians leave out events such as the passage of a periapsis, and outliers, as long as
    these are not more than about a tenth of the samples, are taken out before.

    Args:
        trajectories: sampled about evenly; absent samples are NaN.
    """
    samples, found = trajectories.states, []
    if samples.shape[1] <= ORDERS[-1]:
        return samples.new_full(samples.shape[-1:], torch.nan)
    difference = without_events(samples)
    for order in range(1, ORDERS[-1] + 1):
        difference = difference.diff(dim=1)
        if order in ORDERS:
            typical = difference.abs().flatten(0, 1).nanmedian(0).values
            found.append(typical / (NORMAL * spread(order)))
    level = torch.stack(found)
    changes = (level[1:] / level[:-1] - 1).abs()
    return torch.where((changes <= PLATEAU).all(0), level[0], torch.nan)


def spread(order: int) -> float:
    """Return the standard deviation of the k-th difference of independent noise of unit variance."""
    return math.sqrt(math.comb(2 * order, order))


def without_events(samples: Tensor) -> Tensor:
    """Return samples (B, T, D) with NaN where a difference that is centred there is far larger than most.

    A single outlier is part of k + 1 differences of order k: a few per cent of outliers would reach so many
    of them that medians grow, too. Centred on it is the largest of these.
    """
    order = ORDERS[0]
    sizes = samples.diff(n=order, dim=1).abs()
    values, _ = sizes.flatten(0, 1).nan_to_num(nan=torch.inf).sort(0)
    there = sizes.flatten(0, 1).isfinite().sum(0, keepdim=True)
    low = values.gather(0, (LOW * there).long())
    far = sizes > FAR * low / LOW_NORMAL
    return samples.masked_fill(pad(far, (0, 0, order // 2, order // 2)), torch.nan)


def remark_on(samples: Trajectories, names: Sequence[str], stated: Tensor | None) -> str | None:
    """Return what the user should know of the noise of samples before a training, or None.

    Of samples at unequal steps nothing is said: their differences do not vanish without noise either.

    Args:
        samples: what training sees.
        names: of their D components.
        stated: (D,) standard deviations that the loss takes into account; None for a loss that takes samples
            as exact.
    """
    if isinstance(sampling_interval(samples), Tensor):
        return None
    samples = samples.part(slice(None, None, max(1, samples.times.numel() // LOOKED_AT)))
    floor = noise_floor(samples)
    if stated is None:
        typical = samples.states.diff(dim=1).abs().flatten(0, 1).nanmedian(0).values
        suspicious = (floor > SHARE * typical) & (typical > 0)
        advice = (
            "which this loss learns. Say so: sensor=..., or data.noise=... with recipe=measurements "
            "(recipe=noisy_states where whole states come densely)"
        )
    else:
        suspicious = (floor > TWICE * stated) | (floor < stated / TWICE)
        advice = "data.noise says otherwise: check it, it weighs the measurements"
    levels = zip(names, floor.tolist(), suspicious.tolist(), strict=True)
    found = ", ".join(f"{name} {level:.2g}" for name, level, noisy in levels if noisy)
    if not found:
        return None
    return f"the samples seem to have noise of {found} (standard deviations); {advice}"
