"""How much noise samples have, read off their differences of high order, before anything is trained."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor
from torch.nn.functional import normalize

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
SMALL, MEANS = 0.02, 0.25
"""Noise relative to all that a component moves that needs no test, and by which means may be off."""
TWICE = 2.0
"""Factor by which stated and found noise may differ without a word."""


def noise_floor(samples: Tensor, times: Tensor) -> Tensor:
    """Return the standard deviation of the noise of each component, (D,); NaN where it cannot be told.

    Divided differences of high order leave nothing of a smooth motion, whatever the times of its samples, and
    all of independent noise. Medians leave out events such as the passage of a periapsis, and outliers, as
    long as these are not more than about a tenth of the samples, are taken out before.

    Args:
        samples: (B, T, D) states or measurements; absent ones are NaN.
        times: (B, T).
    """
    plateau = differences_level(samples, times)
    return torch.where(falls_as_noise(samples, times, plateau), plateau, torch.nan)


def differences_level(samples: Tensor, times: Tensor) -> Tensor:
    """Return what differences of all high orders leave of each component, (D,); NaN where they disagree."""
    if samples.shape[1] <= ORDERS[-1]:
        return samples.new_full(samples.shape[-1:], torch.nan)
    level = torch.stack(levels(samples, times, ORDERS))
    changes = (level[1:] / level[:-1] - 1).abs()
    return torch.where((changes <= PLATEAU).all(0), level[0], torch.nan)


def levels(samples: Tensor, times: Tensor, orders: Sequence[int]) -> list[Tensor]:
    """Return the standard deviations (D,) of independent noise that would leave differences as large."""
    kept = without_events(samples, times)
    sizes = [differences(kept, weights(times, order)).abs().flatten(0, 1) for order in orders]
    return [size.nanmedian(0).values / NORMAL for size in sizes]


def falls_as_noise(samples: Tensor, times: Tensor, level: Tensor) -> Tensor:
    """Return for which components (D,) means of m samples in a row show the level over the root of m.

    Those of independent noise do. A motion that is sampled a few times a period leaves differences of high
    order as large as it is itself, but not such means. A level of a small part of the motion needs no test.
    """
    if samples.shape[1] <= ORDERS[-1]:
        return torch.zeros_like(level, dtype=torch.bool)
    flat = samples.flatten(0, 1)
    all_of_it = (flat - flat.nanmean(0)).square().nanmean(0).sqrt()
    small, alike = level < SMALL * all_of_it, level < (1 + MEANS) * all_of_it
    for ratio, allowed in _of_means(samples, times, level):
        alike &= (ratio < allowed) & (ratio > 1 / allowed)
    return small | alike


def is_coloured(samples: Tensor, times: Tensor, level: Tensor) -> Tensor:
    """Return for which components (D,) means of samples in a row show more than white noise would leave.

    Differences of high order see little of noise that correlates from sample to sample.
    """
    found = torch.zeros_like(level, dtype=torch.bool)
    for ratio, allowed in _of_means(samples, times, level):
        found |= ratio > allowed
    return found


def _of_means(samples: Tensor, times: Tensor, level: Tensor) -> Iterator[tuple[Tensor, float]]:
    """Yield what means of two and three samples show over what they would of white noise, and its bound."""
    samples = without_events(samples, times)
    for m in (2, 3):
        count = samples.shape[1] // m
        if (order := min(ORDERS[0], count - 1)) < 2:
            continue
        means, at = (part[:, : m * count].unflatten(1, (count, m)).mean(2) for part in (samples, times))
        ratio = levels(means, at, (order,))[0] * m**0.5 / level
        yield ratio, 1 + MEANS + 2 / (len(samples) * (count - order)) ** 0.5


def weights(times: Tensor, order: int) -> Tensor:
    """Return what samples in a row count in a divided difference of order k: (B, T - k, k + 1).

    They are of unit length, so that the difference of independent noise is as large as the noise.

    Args:
        times: (B, T) increasing, or NaN where samples are absent.
        order: k, at least 1.
    """
    near = times.unfold(1, order + 1, 1)
    near = near / (near[..., -1:] - near[..., :1])  # products of times in any unit stay far from the limits
    found = torch.empty_like(near)
    for j in range(order + 1):
        others = torch.cat((near[..., :j], near[..., j + 1 :]), -1)
        found[..., j] = 1 / (near[..., j : j + 1] - others).prod(-1)
    return normalize(found, dim=-1)


def differences(samples: Tensor, weights: Tensor) -> Tensor:
    """Return the sums (B, T - k, D) of samples (B, T, D) in a row times their weights (B, T - k, k + 1)."""
    return torch.einsum("bidk,bik->bid", samples.unfold(1, weights.shape[-1], 1), weights)


def without_events(samples: Tensor, times: Tensor) -> Tensor:
    """Return samples (B, T, D) with NaN where a difference in which they count most is far larger than most.

    A single outlier is part of k + 1 differences of order k: a few per cent of outliers would reach so many
    of them that medians grow, too. Where it counts most is the largest of these.
    """
    weight = weights(times, min(ORDERS[0], samples.shape[1] - 1))
    sizes = differences(samples, weight).abs()
    values, _ = sizes.flatten(0, 1).nan_to_num(nan=torch.inf).sort(0)
    there = sizes.flatten(0, 1).isfinite().sum(0, keepdim=True)
    low = values.gather(0, (LOW * there).long())
    far = sizes > FAR * low / LOW_NORMAL
    most = weight.abs().argmax(-1) + torch.arange(weight.shape[1])
    hits = torch.zeros_like(samples).scatter_add_(1, most.unsqueeze(-1).expand_as(far), far.to(samples.dtype))
    return samples.masked_fill(hits > 0, torch.nan)


def remark_on(samples: Tensor, times: Tensor, names: Sequence[str], stated: Tensor | None) -> str | None:
    """Return what the user should know of the noise of samples before a training, or None.

    Args:
        samples: (B, T, D) what training sees, of which some are looked at.
        times: (B, T).
        names: of their D components.
        stated: (D,) standard deviations that the loss takes into account; None for a loss that takes samples
            as exact.
    """
    samples, times = looked_at(samples, times)
    floor = noise_floor(samples, times)
    if stated is None:
        typical = samples.diff(dim=1).abs().flatten(0, 1).nanmedian(0).values
        suspicious = (floor > SHARE * typical) & (typical > 0)
        advice = (
            "which this loss learns. Say so: sensor=... (of files sensor=recorded), or data.noise=... with "
            "recipe=measurements (recipe=noisy_states where whole states come densely)"
        )
    else:
        coloured = is_coloured(samples, times, floor)
        suspicious = (floor > TWICE * stated) | ((floor < stated / TWICE) & ~coloured)
        advice = "data.noise says otherwise: check it, it weighs the measurements"
    levels = zip(names, floor.tolist(), suspicious.tolist(), strict=True)
    found = ", ".join(f"{name} {level:.2g}" for name, level, noisy in levels if noisy)
    if not found:
        return None
    rare = "unless they come too rarely to tell"
    return f"the samples seem to have noise of {found} (standard deviations), {rare}; {advice}"


def looked_at(samples: Tensor, times: Tensor) -> tuple[Tensor, Tensor]:
    """Return the beginnings of some trajectories, evenly chosen, of `LOOKED_AT` samples in all."""
    some = slice(None, None, max(1, times.numel() // LOOKED_AT))
    count = max(LOOKED_AT // len(times[some]), ORDERS[-1] + 1)
    return samples[some, :count], times[some, :count]
