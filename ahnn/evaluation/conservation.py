"""Whether data conserve what a model conserves: tests of dissipation and of dependence on time.

A learned Hamiltonian is a function of the state that its own flow conserves. Along data without friction it
stays where it is, up to the error of the model, and has no trend; along data with friction it falls.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.dynamics.forced import Forced
from ahnn.evaluation.case import Case
from ahnn.numbers import in_percent
from ahnn.rollouts import clock_of, stepped

PIECES = 8
"""Pieces of trajectories whose trends are compared, at least."""
SURE = 6.0
"""Standard errors beyond which a trend is none of chance."""
NOTABLE = 0.02
"""Fraction of the energy above its least that a trajectory loses or wins, from which it is worth a word."""
COMMON = 0.5
"""Fraction of what a model misses that all trajectories share at one time, from which time itself acts."""
MISSED = 1e-3
"""What a model misses of a step, as a fraction of the steps, from which it is worth a word."""
TOGETHER = 0.9
"""Fraction of the spread of the states that time explains, from which state and time are not told apart."""
DEGREE = 4
"""Of the polynomials of the state that what a model misses is compared with first."""
FEATURES = 150
"""Such polynomials, at most."""


class Trend(NamedTuple):
    """How the learned energy changes along data.

    Attributes:
        rate: of the energy above its least, as a fraction in a unit of time; negative where it is lost.
        error: standard error of the rate.
        whole: the change over a trajectory, as a fraction.
    """

    rate: float
    error: float
    whole: float

    @property
    def found(self) -> bool:
        """Whether the data win or lose energy."""
        return abs(self.rate) > SURE * self.error and abs(self.whole) > NOTABLE

    def sentence(self, unit: str) -> str:
        """Return the finding in words; "" where the energy has no trend."""
        if not self.found:
            return ""
        per = "in a unit of time" if unit == "1" else f"per {unit}"
        verb, remedy = ("lose", "forces=friction") if self.rate < 0 else ("gain", "forces=network")
        return (
            f"the data {verb} {in_percent(abs(self.rate))} of their energy {per}, and a Hamiltonian alone "
            f"conserves it: add {remedy}"
        )


class TimeTest(NamedTuple):
    """Whether what a model misses depends on time.

    Attributes:
        common: fraction of it that all trajectories share at one time.
        missed: rms of it, as a fraction of the rms step.
    """

    common: float
    missed: float

    @property
    def found(self) -> bool:
        """Whether time itself acts."""
        return self.common > COMMON and self.missed > MISSED

    def sentence(self) -> str:
        """Return the finding in words; "" where time does not show."""
        if not self.found:
            return ""
        return (
            f"{in_percent(self.common)} of what the model misses is common to all trajectories at one time: "
            "a force of time acts, and the model has none: add forces=forcing, or forces=network with "
            "model.forces.network.sees=[q,v,t]"
        )


def conserves(flow: Any) -> bool:
    """Return whether a flow conserves its energy: no force beside the Hamiltonian does work."""
    field = getattr(flow, "field", None)
    return not (isinstance(field, Forced) and field.forces_work)


def energy_trend(case: Case) -> Trend | None:
    """Return how the learned energy changes along the test trajectories; None where that says nothing."""
    if case.energy is None or not conserves(case.flow):
        return None
    states, times = case.test.states, case.test.times
    energy = torch.where(case.test.present, case.energy(states.nan_to_num()), torch.nan)
    parts = -(-PIECES // len(states))
    length = energy.shape[1] // parts
    if length < 3:
        return None
    cut = [x[:, : parts * length].reshape(-1, length) for x in (energy, times)]
    slopes, middles = slope(*cut)
    above = middles - energy[energy.isfinite()].min()
    known = slopes.isfinite() & above.isfinite()
    slopes, above, weight = slopes[known], above[known], float(above[known].square().sum())
    if len(slopes) < PIECES or not weight > 0:
        return None
    rate = float((slopes * above).sum()) / weight  # of slopes in proportion to the energy
    left = (slopes - rate * above).square().sum() / (len(slopes) - 1)
    span = float((times.nan_to_num(nan=-torch.inf).amax(1) - times[:, 0]).median())
    return Trend(rate, (float(left) / weight) ** 0.5, rate * span)


def slope(values: Tensor, times: Tensor) -> tuple[Tensor, Tensor]:
    """Return slopes and means of values (B, T) over times (B, T), shape (B,), NaN where too few are there."""
    t = torch.where(values.isfinite(), times, torch.nan)
    t = t - t.nanmean(1, keepdim=True)
    middle = values.nanmean(1)
    return (t * (values - middle[:, None])).nansum(1) / t.square().nansum(1), middle


def time_test(case: Case) -> TimeTest | None:
    """Return whether time itself acts on the test trajectories; None where that says nothing.

    Residuals of single steps, less the polynomial of the state that fits them best, are compared with their
    mean over the trajectories at each time. Where all trajectories run in step, what depends on the state
    depends on time.
    """
    states, times = case.test.states, case.test.times
    if clock_of(case.flow) or isinstance(case.dt, Tensor) or len(states) < PIECES:
        return None
    if not bool(case.test.present.all()) or not bool((times == times[:1]).all()):
        return None
    size = states.shape[-1]
    steps = states.diff(dim=1)
    with torch.no_grad():
        after = stepped(case.flow, states[:, :-1].reshape(-1, size), case.dt).reshape_as(steps)
    missed = states[:, 1:] - after
    scale = steps.square().mean((0, 1)).sqrt()
    moving = scale > 0
    missed = missed[..., moving] / scale[moving]
    if shared(states) > TOGETHER:
        return None
    left = without_state(missed, states[:, :-1])
    fraction = float((left.square().mean() / missed.square().mean()).nan_to_num())
    return TimeTest(fraction * shared(left), float(missed.square().mean().sqrt()))


def without_state(values: Tensor, states: Tensor) -> Tensor:
    """Return what polynomials of the states (B, T, D) do not explain of values (B, T, C)."""
    flat = states.flatten(0, 1)
    scaled = (flat - flat.mean(0)) / flat.std(0).clamp(min=1e-300)
    features, products = [torch.ones_like(flat[:, :1])], torch.ones_like(flat[:, :1])
    for _ in range(DEGREE):  # all products, those that occur twice as well: a least norm does not mind
        products = (products.unsqueeze(-1) * scaled.unsqueeze(-2)).flatten(1)
        if sum(part.shape[1] for part in features) + products.shape[1] > FEATURES:
            break
        features.append(products)
    design, target = torch.cat(features, dim=1), values.flatten(0, 1)
    found = torch.linalg.lstsq(design, target, driver="gelsd").solution
    return (target - design @ found).reshape(values.shape)


def shared(values: Tensor) -> float:
    """Return the fraction of the variance of values (B, T, C) that their mean over B explains, unbiased."""
    left = values - values.mean((0, 1))
    whole = left.square().mean((0, 1))
    inside = (left - left.mean(0)).square().sum(0).mean(0) / (len(values) - 1)
    kept = whole > 0
    return float((1 - inside[kept] / whole[kept]).mean()) if bool(kept.any()) else 0.0
