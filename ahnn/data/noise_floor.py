"""Noise level of samples from high-order differences, before training."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor
from torch.nn.functional import normalize

ORDERS = (8, 9, 10)
"""Orders of the differences: smooth motion vanishes in them, unless it is sampled too sparsely."""
PLATEAU = 0.2
"""Relative change between orders above which motion dominates the differences."""
NORMAL = 0.6745
"""Median absolute value of a standard normal number."""
LOW, LOW_NORMAL = 0.2, 0.2533
"""Quantile of differences that is robust to a few outliers, and its value for standard normal differences."""
FAR = 6.0
"""Standard deviations of a difference beyond which its central sample is excluded."""
SHARE = 1e-4
"""Noise relative to increments above which objectives that compare windows learn the noise."""
LOOKED_AT = 2**16
"""Number of samples for medians accurate to one per cent."""
SMALL, MEANS = 0.02, 0.25
"""Noise, relative to a component's total motion, that needs no test, and relative tolerance of the means."""
MODERATE = 0.1
"""Noise, relative to a component's total motion, below which only means of two samples limit it."""
PURE = ("1", "1 · mass")
"""Units of components without a unit."""
TWICE = 2.0
"""Tolerated factor between stated and estimated noise."""


def noise_floor(samples: Tensor, times: Tensor) -> Tensor:
    """Estimate the noise standard deviation of each component, (D,); NaN if undetermined.

    High-order divided differences remove smooth motion for any sample times, and preserve independent noise.
    Medians are insensitive to events such as a periapsis passage, and outliers, up to about a tenth of the
    samples, are removed beforehand.

    Args:
        samples: (B, T, D) states or measurements; NaN where missing.
        times: (B, T) sample times.
    """
    plateau = differences_level(samples, times)
    return torch.where(falls_as_noise(samples, times, plateau), plateau, torch.nan)


def differences_level(samples: Tensor, times: Tensor) -> Tensor:
    """Return the noise level from differences of all high orders, (D,); NaN where they disagree."""
    if samples.shape[1] <= ORDERS[-1]:
        return samples.new_full(samples.shape[-1:], torch.nan)
    level = torch.stack(levels(samples, times, ORDERS))
    changes = (level[1:] / level[:-1] - 1).abs()
    return torch.where((changes <= PLATEAU).all(0), level[0], torch.nan)


def levels(samples: Tensor, times: Tensor, orders: Sequence[int]) -> list[Tensor]:
    """Return, for each order, the standard deviations (D,) of independent noise with equal differences."""
    kept = without_events(samples, times)
    sizes = [differences(kept, weights(times, order)).abs().flatten(0, 1) for order in orders]
    return [size.nanmedian(0).values / NORMAL for size in sizes]


def falls_as_noise(samples: Tensor, times: Tensor, level: Tensor) -> Tensor:
    """Return the mask (D,) of components whose means of m consecutive samples have the level / sqrt(m).

    This holds for independent noise. Motion sampled only a few times per period has high-order differences as
    large as itself, but not such means. Levels small relative to the motion need no test, and for moderate
    ones means of three samples, which are fewer per period, may also contain motion.
    """
    if samples.shape[1] <= ORDERS[-1]:
        return torch.zeros_like(level, dtype=torch.bool)
    flat = samples.flatten(0, 1)
    all_of_it = (flat - flat.nanmean(0)).square().nanmean(0).sqrt()
    small, alike = level < SMALL * all_of_it, level < (1 + MEANS) * all_of_it
    moderate = level < MODERATE * all_of_it
    for m, ratio, allowed in _of_means(samples, times, level):
        alike &= ((ratio < allowed) | (moderate & (m > 2))) & (ratio > 1 / allowed)
    return small | alike


def is_coloured(samples: Tensor, times: Tensor, level: Tensor) -> Tensor:
    """Return the mask (D,) of components whose means of consecutive samples exceed those of white noise.

    High-order differences are insensitive to noise correlated between samples.
    """
    found = torch.zeros_like(level, dtype=torch.bool)
    for _, ratio, allowed in _of_means(samples, times, level):
        found |= ratio > allowed
    return found


def _of_means(samples: Tensor, times: Tensor, level: Tensor) -> Iterator[tuple[int, Tensor, float]]:
    """Yield, for two and three samples, the level of their means relative to white noise, and its bound."""
    samples = without_events(samples, times)
    for m in (2, 3):
        count = samples.shape[1] // m
        if (order := min(ORDERS[0], count - 1)) < 2:
            continue
        means, at = (part[:, : m * count].unflatten(1, (count, m)).mean(2) for part in (samples, times))
        ratio = levels(means, at, (order,))[0] * m**0.5 / level
        yield m, ratio, 1 + MEANS + 2 / (len(samples) * (count - order)) ** 0.5


def weights(times: Tensor, order: int) -> Tensor:
    """Return the weights of consecutive samples in a divided difference of order k: (B, T - k, k + 1).

    They have unit norm, so that the difference of independent noise is as large as the noise.

    Args:
        times: (B, T) increasing times, NaN where samples are missing.
        order: order k, at least 1.
    """
    near = times.unfold(1, order + 1, 1)
    near = near / (near[..., -1:] - near[..., :1])  # avoids overflow for times in any unit
    found = torch.empty_like(near)
    for j in range(order + 1):
        others = torch.cat((near[..., :j], near[..., j + 1 :]), -1)
        found[..., j] = 1 / (near[..., j : j + 1] - others).prod(-1)
    return normalize(found, dim=-1)


def differences(samples: Tensor, weights: Tensor) -> Tensor:
    """Return differences (B, T - k, D) of samples (B, T, D) with weights (B, T - k, k + 1)."""
    return torch.einsum("bidk,bik->bid", samples.unfold(1, weights.shape[-1], 1), weights)


def without_events(samples: Tensor, times: Tensor) -> Tensor:
    """Return samples (B, T, D), NaN where a difference centred on them is exceptionally large.

    A single outlier affects k + 1 differences of order k: a few per cent of outliers would affect enough of
    them to increase medians. The difference in which it has the largest weight is the largest.
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


def remark_on(
    samples: Tensor, times: Tensor, names: Sequence[str], units: Sequence[str], stated: Tensor | None
) -> str | None:
    """Return a remark for the user on the noise of samples before training, or None.

    Args:
        samples: (B, T, D) training samples, of which some are examined.
        times: (B, T) sample times.
        names: names of their D components.
        units: units of these components, "1" for pure numbers.
        stated: (D,) standard deviations used by the loss; None for a loss that assumes exact samples.
    """
    samples, times = looked_at(samples, times)
    floor = noise_floor(samples, times)
    if stated is None:
        typical = samples.diff(dim=1).abs().flatten(0, 1).nanmedian(0).values
        suspicious = (floor > SHARE * typical) & (typical > 0)
        advice = (
            "this loss would learn the noise. Declare it: sensor=... (sensor=recorded for files), or "
            "data.noise=... with recipe=measurements (recipe=noisy_states for densely sampled states)"
        )
    else:
        coloured = is_coloured(samples, times, floor)
        suspicious = (floor > TWICE * stated) | ((floor < stated / TWICE) & ~coloured)
        advice = "data.noise differs: check it, since it weights the measurements"
    levels = zip(names, floor.tolist(), units, suspicious.tolist(), strict=True)
    found = ", ".join(
        f"{name} {level:.2g}" + ("" if unit in PURE else f" {unit}")
        for name, level, unit, noisy in levels
        if noisy
    )
    if not found:
        return None
    rare = "unless they are too sparse to tell"
    return f"the samples seem to be noisy, with standard deviations of {found}, {rare}; {advice}"


def looked_at(samples: Tensor, times: Tensor) -> tuple[Tensor, Tensor]:
    """Return the first samples of evenly spaced trajectories, about `LOOKED_AT` samples in total."""
    some = slice(None, None, max(1, times.numel() // LOOKED_AT))
    count = max(LOOKED_AT // len(times[some]), ORDERS[-1] + 1)
    return samples[some, :count], times[some, :count]
