"""Conservation tests of data: dissipation and explicit time dependence.

A learned Hamiltonian is conserved by its own flow. Along data without friction it is constant up to the model
error, without a trend; along data with friction it decreases.
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
"""Minimum number of trajectory segments whose trends are compared."""
THIRDS = 3
"""Successive parts of the trajectories that must all show a trend: friction acts all the time, whereas the
energy error of a poor model changes its sign."""
IN_PART = 2.0
"""Standard errors beyond which a part shows the trend."""
EMPTY = 0.05
"""Fraction of the squared energy below which a part is too quiet to show a trend."""
SURE = 6.0
"""Number of standard errors beyond which a trend is significant."""
NOTABLE = 0.02
"""Minimum reported gain or loss of a trajectory, as a fraction of the energy above its minimum."""
COMMON = 0.5
"""Minimum variance fraction, common to all trajectories at a given time, that shows time dependence."""
MISSED = 1e-3
"""Minimum rms model residual of a step that is reported, as a fraction of the rms step."""
TOGETHER = 0.9
"""Fraction of the state variance explained by time above which state and time are indistinguishable."""
DEGREE = 4
"""Maximum degree of the polynomial of the state that is subtracted from model residuals."""
FEATURES = 150
"""Maximum number of terms of this polynomial."""


class Trend(NamedTuple):
    """Trend of the learned energy along data.

    Attributes:
        rate: relative rate of the energy above its minimum, per unit of time; negative for a loss.
        error: standard error of the rate.
        whole: relative change over a trajectory.
        lasting: whether every part of the trajectories shows the trend.
    """

    rate: float
    error: float
    whole: float
    lasting: bool

    @property
    def found(self) -> bool:
        """Whether the data gain or lose energy significantly, in every part of the trajectories."""
        return self.lasting and abs(self.rate) > SURE * self.error and abs(self.whole) > NOTABLE

    def sentence(self, unit: str) -> str:
        """Return the finding in words; "" without a trend."""
        if not self.found:
            return ""
        per = "per unit of time" if unit == "1" else f"per {unit}"
        verb, remedy = ("falls", "forces=friction") if self.rate < 0 else ("rises", "forces=network")
        return (
            f"along the data the learned energy {verb} by {in_percent(abs(self.rate))} {per}, although a "
            f"Hamiltonian without forces conserves it: add {remedy}"
        )


class TimeTest(NamedTuple):
    """Test of explicit time dependence of model residuals.

    Attributes:
        common: fraction of the residual variance common to all trajectories at equal times.
        missed: rms residual, as a fraction of the rms step.
    """

    common: float
    missed: float

    @property
    def found(self) -> bool:
        """Whether an explicit time dependence is found."""
        return self.common > COMMON and self.missed > MISSED

    def sentence(self) -> str:
        """Return the finding in words; "" without time dependence."""
        if not self.found:
            return ""
        return (
            f"{in_percent(self.common)} of the model error is common to all trajectories at a given time: a "
            "time-dependent force is missing from the model; add forces=forcing, or forces=network with "
            "model.forces.network.sees=[q,v,t]"
        )


def conserves(flow: Any) -> bool:
    """Return whether a flow conserves its energy, i.e. has no non-conservative forces."""
    field = getattr(flow, "field", None)
    return not (isinstance(field, Forced) and field.forces_work)


def energy_trend(case: Case) -> Trend | None:
    """Return the trend of the learned energy along the test trajectories; None if inconclusive."""
    if case.energy is None or not conserves(case.flow):
        return None
    states, times = case.test.states, case.test.times
    energy = torch.where(case.test.present, case.energy(states.nan_to_num()), torch.nan)
    parts = max(THIRDS, -(-PIECES // len(states)))
    length = energy.shape[1] // parts
    if length < 3:
        return None
    cut = [x[:, : parts * length].reshape(-1, length) for x in (energy, times)]
    slopes, middles = slope(*cut)
    above = middles - energy[energy.isfinite()].min()
    third = torch.arange(parts).mul(THIRDS).div(parts, rounding_mode="floor").repeat(len(states))
    known = slopes.isfinite() & above.isfinite()
    slopes, above, third = slopes[known], above[known], third[known]
    weight = float(above.square().sum())
    if len(slopes) < PIECES or not weight > 0:
        return None
    rate, error = relative_rate(slopes, above)
    span = float((times.nan_to_num(nan=-torch.inf).amax(1) - times[:, 0]).median())
    in_thirds = [(slopes[third == k], above[third == k]) for k in range(THIRDS)]
    shown = [relative_rate(*part) for part in in_thirds if float(part[1].square().sum()) > EMPTY * weight]
    lasting = all(own * rate > 0 and abs(own) > IN_PART * own_error for own, own_error in shown)
    return Trend(rate, error, rate * span, lasting)


def relative_rate(slopes: Tensor, values: Tensor) -> tuple[float, float]:
    """Return the rate r of the fit slopes = r values over segments, shapes (N,), and its standard error."""
    weight = float(values.square().sum())
    rate = float((slopes * values).sum()) / weight
    left = float((slopes - rate * values).square().sum()) / max(len(slopes) - 1, 1)
    return rate, (left / weight) ** 0.5


def slope(values: Tensor, times: Tensor) -> tuple[Tensor, Tensor]:
    """Return slopes and means of values (B, T) over times (B, T), shape (B,), NaN for too few values."""
    t = torch.where(values.isfinite(), times, torch.nan)
    t = t - t.nanmean(1, keepdim=True)
    middle = values.nanmean(1)
    return (t * (values - middle[:, None])).nansum(1) / t.square().nansum(1), middle


def time_test(case: Case) -> TimeTest | None:
    """Check the test trajectories for explicit time dependence; None if inconclusive.

    One-step residuals minus their best-fitting polynomial of the state are compared with their mean over
    trajectories at each time. If trajectories are synchronous, state and time are indistinguishable.
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
    """Return values (B, T, C) minus their best-fitting polynomials of states (B, T, D)."""
    flat = states.flatten(0, 1)
    scaled = (flat - flat.mean(0)) / flat.std(0).clamp(min=1e-300)
    features, products = [torch.ones_like(flat[:, :1])], torch.ones_like(flat[:, :1])
    for _ in range(DEGREE):  # all products, including duplicates: a minimum-norm solution allows them
        products = (products.unsqueeze(-1) * scaled.unsqueeze(-2)).flatten(1)
        if sum(part.shape[1] for part in features) + products.shape[1] > FEATURES:
            break
        features.append(products)
    design, target = torch.cat(features, dim=1), values.flatten(0, 1)
    found = torch.linalg.lstsq(design, target, driver="gelsd").solution
    return (target - design @ found).reshape(values.shape)


def shared(values: Tensor) -> float:
    """Return the fraction of the variance of values (B, T, C) explained by their mean over B, unbiased."""
    left = values - values.mean((0, 1))
    whole = left.square().mean((0, 1))
    inside = (left - left.mean(0)).square().sum(0).mean(0) / (len(values) - 1)
    kept = whole > 0
    return float((1 - inside[kept] / whole[kept]).mean()) if bool(kept.any()) else 0.0
