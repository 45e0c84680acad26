"""Diagnosis of residuals beyond white noise: noise level, bias, colour, outliers, or dynamics."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor, nn

from ahnn.data.segments import whole
from ahnn.evaluation.goodness_of_fit import OUTLYING, explain, fit_to
from ahnn.evaluation.residual_tests import ResidualTests, residual_tests
from ahnn.measurements import NoiseEstimate, Observations, Position, Segment, State
from ahnn.numbers import in_percent
from ahnn.shooting.robust import RobustName

SURE = 4.0
"""Number of standard errors beyond which a finding is significant."""
EXPLAINED = 0.05
"""Fraction of the residual variance explained by the state above which the dynamics are wrong; doubled if
successive residuals are uncorrelated, for example a quarter of a period apart.
"""
COLOURED, BIASED = 0.15, 0.2
"""Minimum reported correlation of successive residuals, and constant offset in standard deviations."""
OFF = 1.4
"""Minimum reported factor between data.noise and the actual noise; bands are wrong by the same factor."""
ENOUGH, MOST = 400, 4000
"""Number of unseen values that suffice for a diagnosis, and approximate maximum of those of the training."""
FEW = 1e-3
"""Minimum reported fraction of outliers; normal noise has 6e-5."""


def diagnosis(dynamics: nn.Module, unseen: Segment, training: Segment | None, robust: RobustName) -> str:
    """Diagnose why a model does not explain unseen measurements, with remedies; "" without a finding.

    A few unseen measurements do not tell the noise from the model; those of the training then do.

    Args:
        dynamics: float64 dynamics with an `increment` method.
        unseen: measurements not used in training.
        training: measurements used in training, if known.
        robust: robust loss of the training.
    """
    some = sufficient(unseen, training)
    if (said := remedy(dynamics, some, robust)) or some is unseen:
        return said
    seen = explain(dynamics, some, robust)
    if not seen.chi_square <= seen.band[1]:
        return ""
    return (
        f"the measurements of the training have {seen.chi_square:#.3g} times the noise variance: the model "
        "fits these better than the unseen ones, so that more trajectories would help"
    )


def sufficient(unseen: Segment, training: Segment | None) -> Segment:
    """Return the unseen measurements if they suffice for a diagnosis, otherwise some of the training."""
    few = int(unseen.measured.sum()) < ENOUGH
    if training is None or not few or int(training.measured.sum()) <= int(unseen.measured.sum()):
        return unseen
    some = training.rows(training.measured.cumsum(0) <= max(MOST, int(training.measured[0])))
    return whole(Observations(some.values, some.times), some.instrument)


@torch.no_grad()
def remedy(dynamics: nn.Module, segment: Segment, robust: RobustName) -> str:
    """Diagnose the residuals of robustly fitted paths, with remedies; "" without a finding.

    Args:
        dynamics: float64 dynamics with an `increment` method.
        segment: measurements.
        robust: robust loss of the training.
    """
    segment = segment.rows(segment.measured > 2 * segment.instrument.dof + 2)
    if not len(segment.times):
        return ""
    fitted, steps = fit_to(dynamics, segment, "student")
    states = fitted.states[:, steps.ends]
    left = segment.scores(states).masked_fill(segment.values.isnan(), torch.nan)
    unknowns = 2 * segment.instrument.dof
    all_of_it = residual_tests(left, states, segment.times, unknowns)
    far = left.abs() > OUTLYING * all_of_it.scale.clamp(min=1)
    found = residual_tests(left.masked_fill(far, torch.nan), states, segment.times, unknowns)
    found = found._replace(tails=all_of_it.tails)
    interval = float(segment.times.diff(dim=1).median())
    return "; ".join(verdicts(found, segment.instrument.measurement.names, interval, robust))


def invisible(dynamics: nn.Module, segment: Segment, noise: NoiseEstimate | None = None) -> str:
    """Return a remark that a bias of all readings would go unnoticed; "" if it is visible or estimated."""
    direct = isinstance(segment.instrument.measurement, (Position, State))
    if not direct or getattr(dynamics, "anchored", True) or (noise is not None and noise.bias):
        return ""
    return (
        "a constant bias of the readings would go unnoticed, since the learned functions shift with it; "
        "bands do not include it unless data.bias_sd gives its standard deviation"
    )


def verdicts(found: ResidualTests, names: tuple[str, ...], interval: float, robust: RobustName) -> list[str]:
    """Return the diagnoses as text.

    Args:
        found: test results for each of the M measured values.
        names: names of the values.
        interval: typical time between two measurements.
        robust: robust loss of the training.
    """
    pairs = found.pairs.clamp(min=1)
    found = found._replace(scale=_significant(found))
    coloured = found.correlation > (SURE / pairs.sqrt()).clamp(min=COLOURED)
    if bool((found.explained > torch.where(coloured, EXPLAINED, 2 * EXPLAINED)).any()):
        fraction = in_percent(float(found.explained.clamp(min=0).max()))
        larger = _sizes(
            found.scale.clamp(max=1), names
        )  # wrong dynamics increase residuals beyond the noise, never decrease them
        return [
            *larger,
            f"{fraction} of the residual variance depends on the state: the model misses part of the motion",
        ]
    said = [f"{size} (data.noise=estimate finds it)" for size in _sizes(found.scale, names)]
    if bool(coloured.any()):
        said.append(_colour(found, names, coloured, interval))
    said += _biases(found, names, coloured)
    if robust == "none" and float(found.tails.max()) > FEW and bool((found.tails * pairs > 2).any()):
        outliers = in_percent(float(found.tails.max()))
        said.append(
            f"{outliers} of the values are outliers: set loss.robust=student to downweight them, or "
            "data.tails=estimate to model them"
        )
    return said


def _significant(found: ResidualTests) -> Tensor:
    """Return scales (M,), 1 where the difference is no more than chance; correlated values count less."""
    correlation = found.correlation.clamp(0, 0.99)
    independent = (found.pairs * (1 - correlation) / (1 + correlation)).clamp(min=1)
    sure = found.scale.log().abs() > SURE / (2 * independent).sqrt()
    return torch.where(sure, found.scale, 1.0)


def _listed(entries: Iterable[tuple[str, float, bool]]) -> str:
    return ", ".join(f"{name} {value:+.2g}" for name, value, significant in entries if significant)


def _sizes(scales: Tensor, names: tuple[str, ...]) -> list[str]:
    """Return a remark on values whose stated noise is wrong, if any."""
    off = [
        f"{max(scale, 1 / scale):.2g} times too {'small' if scale > 1 else 'large'} for {name}"
        for name, scale in zip(names, scales.tolist(), strict=True)
        if scale > 0 and not 1 / OFF < scale < OFF
    ]
    return [f"data.noise is about {', '.join(off)}"] if off else []


def _colour(found: ResidualTests, names: tuple[str, ...], coloured: Tensor, interval: float) -> str:
    """Return a remark on noise correlated in time."""
    correlation = found.correlation.clamp(max=0.99)
    widening = float(((1 + correlation) / (1 - correlation)).sqrt()[coloured].max())
    memory = -interval / float(correlation[coloured].max().log())
    each = _listed(zip(names, correlation.tolist(), coloured.tolist(), strict=True))
    return (
        f"the noise is coloured: successive values correlate by {each} (correlation time about "
        f"{memory:.2g}), and bands are up to {widening:.2g} times too narrow; data.correlation=estimate "
        "accounts for it in training, and measurement.bias_memory in filters"
    )


def _biases(found: ResidualTests, names: tuple[str, ...], coloured: Tensor) -> list[str]:
    """Return remarks on a bias common to all measurements, and on one that differs between trajectories."""
    correlation = torch.where(coloured, found.correlation.clamp(0, 0.99), 0)
    chance = (1 + correlation) / (1 - correlation)
    count = max(found.trajectories, 2)
    spreads = (found.spread > BIASED) & (found.spread_ratio > chance * (1 + SURE * (2 / (count - 1)) ** 0.5))
    error = found.bias_error * torch.where(found.spread_ratio < chance, chance / found.spread_ratio, 1).sqrt()
    constant = (found.bias.abs() > BIASED) & (found.bias.abs() > SURE * error)
    said: list[str] = []
    if bool(constant.any()):
        each = _listed(zip(names, found.bias.neg().tolist(), constant.tolist(), strict=True))
        said.append(
            f"readings are biased: {each} standard deviations of the noise on average; data.bias_sd=NUMBER "
            "estimates this bias with the dynamics"
        )
    if bool(spreads.any()):
        each = _listed(zip(names, found.spread.tolist(), spreads.tolist(), strict=True)).replace("+", "")
        said.append(
            f"each trajectory has its own bias: {each} standard deviations of the noise; "
            "measurement.bias_sd estimates it in filters"
        )
    return said
