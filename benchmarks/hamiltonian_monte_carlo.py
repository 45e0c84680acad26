"""Hamiltonian Monte Carlo of several chains at once, with the usual diagnostics.

The density is one of standardised variables u, theta = centre + L u with L L^T an approximate covariance, so
that the mass matrix is the identity (Neal 2011, Handbook of Markov Chain Monte Carlo, chapter 5). All chains
share one step length. It is tuned by dual averaging to the wanted acceptance during the warm-up and then kept
(Hoffman & Gelman 2014, J. Mach. Learn. Res. 15, 1593-1623). Each trajectory draws its step length about that
value, so that no oscillation of the density is in phase with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Generator, Tensor

Density = Callable[[Tensor], Tensor]
"""Standardised variables (C, P), differentiable -> logarithms of the density (C,), but for a constant."""

WANTED = 0.8
"""Mean acceptance to which the step length is tuned."""
JITTER = 0.2
"""Largest relative deviation of a trajectory's step length."""
FIRST = 0.4
"""Initial step length, in standard deviations."""


class Chains(NamedTuple):
    """Draws of C chains.

    Attributes:
        draws: (C, N, P), after the warm-up.
        acceptance: mean probability of acceptance after the warm-up.
        step: step length after the warm-up.
    """

    draws: Tensor
    acceptance: float
    step: float

    def thinned(self, count: int) -> Tensor:
        """Return about `count` draws of all chains at equal distances, (about count, P)."""
        every = max(1, self.draws.shape[0] * self.draws.shape[1] // count)
        return self.draws.transpose(0, 1).flatten(0, 1)[::every]


class Point(NamedTuple):
    """State of the chains: places (C, P), log densities (C,), and their gradients (C, P)."""

    place: Tensor
    density: Tensor
    slope: Tensor


def sampled(density: Density, begin: Tensor, warmup: int, draws: int, leaps: int, seed: int) -> Chains:
    """Sample a density by Hamiltonian Monte Carlo.

    Args:
        density: logarithm of the density, of standardised variables.
        begin: first places of the chains, (C, P), float64.
        warmup: number of trajectories that tune the step length; their ends are no draws.
        draws: number of draws of each chain, N.
        leaps: steps of a trajectory.
        seed: seed of all random numbers.
    """
    generator = Generator().manual_seed(seed)
    here, tuned = _at(density, begin), _Tuned(FIRST)
    found, rates = [], []
    for k in range(warmup + draws):
        step = tuned.trial if k < warmup else tuned.settled
        jitter = 1 + JITTER * (2 * float(torch.rand((), generator=generator)) - 1)
        here, rate = _moved(density, here, jitter * step, leaps, generator)
        if k < warmup:
            tuned.learn(rate)
        else:
            found.append(here.place)
            rates.append(rate)
    return Chains(torch.stack(found, dim=1), sum(rates) / len(rates), tuned.settled)


def _at(density: Density, place: Tensor) -> Point:
    """Return the chains at places (C, P); the density is zero where it is not finite."""
    with torch.enable_grad():
        variables = place.detach().requires_grad_()
        value = density(variables)
        (slope,) = torch.autograd.grad(value.sum(), variables)
    known = value.isfinite() & slope.isfinite().all(-1)
    value = torch.where(known, value.detach(), -torch.inf)
    return Point(place, value, torch.where(known[:, None], slope, 0.0))


def _moved(
    density: Density, here: Point, step: float, leaps: int, generator: Generator
) -> tuple[Point, float]:
    """Return the chains after one trajectory, and the mean probability of acceptance."""
    momentum = torch.randn(here.place.shape, generator=generator, dtype=here.place.dtype)
    there, speed = here, momentum
    for _ in range(leaps):
        speed = speed + step / 2 * there.slope
        there = _at(density, there.place + step * speed)
        speed = speed + step / 2 * there.slope
    before = here.density - momentum.square().sum(-1) / 2
    after = there.density - speed.square().sum(-1) / 2
    probability = (after - before).clamp(max=0).exp()
    taken = torch.rand(len(probability), generator=generator, dtype=probability.dtype) < probability
    place = torch.where(taken[:, None], there.place, here.place)
    slope = torch.where(taken[:, None], there.slope, here.slope)
    return Point(place, torch.where(taken, there.density, here.density), slope), float(probability.mean())


class _Tuned:
    """Step length by dual averaging, with the constants of Hoffman & Gelman (2014), section 3.2.1."""

    def __init__(self, first: float) -> None:
        self.trial = self.settled = first
        self._aim, self._count, self._excess, self._mean = math.log(10 * first), 0, 0.0, 0.0

    def learn(self, rate: float) -> None:
        """Adapt to the acceptance of the last trajectory."""
        self._count += 1
        k = self._count
        share = 1 / (k + 10)
        self._excess = (1 - share) * self._excess + share * (WANTED - rate)
        log = self._aim - math.sqrt(k) / 0.05 * self._excess
        weight = k**-0.75
        self._mean = weight * log + (1 - weight) * self._mean
        self.trial, self.settled = math.exp(log), math.exp(self._mean)


def split_rhat(draws: Tensor) -> Tensor:
    """Return the split R-hat of each variable, (P,), of draws (C, N, P).

    Each chain counts as two halves; values near 1 show no difference between the halves (Gelman et al. 2013,
    Bayesian Data Analysis, section 11.4).
    """
    half = draws.shape[1] // 2
    halves = torch.cat((draws[:, :half], draws[:, -half:]))
    within = halves.var(1).mean(0)
    return ((half - 1) / half + halves.mean(1).var(0) / within).sqrt()


def effective_draws(draws: Tensor) -> Tensor:
    """Return the effective number of independent draws of each variable, (P,), of draws (C, N, P).

    Autocorrelations of all chains are combined, and summed in pairs up to the first negative pair (Geyer
    1992; Vehtari et al. 2021, Bayesian Analysis 16, 667-718, section 3.2).
    """
    chains, count, _ = draws.shape
    off = draws - draws.mean(1, keepdim=True)
    spectrum = torch.fft.rfft(off, n=2 * count, dim=1).abs().square()
    covariance = torch.fft.irfft(spectrum, dim=1)[:, :count].mean(0) / count
    within = covariance[0] * count / (count - 1)
    total = within * (count - 1) / count + (draws.mean(1).var(0) if chains > 1 else 0.0)
    correlation = 1 - (within - covariance) / total
    correlation[0] = 1.0
    pairs = correlation[: count // 2 * 2].unflatten(0, (-1, 2)).sum(1)
    pairs = torch.where((pairs < 0).cumsum(0) > 0, 0.0, pairs).cummin(0).values
    return chains * count / (2 * pairs.sum(0) - 1).clamp(min=1 / math.log10(chains * count))
