"""Final steps of training with unknown noise: fit, estimate the noise from the residuals, fit again."""

from __future__ import annotations

import logging
import math

import torch
from torch import Tensor

from ahnn.data.noise_floor import NORMAL
from ahnn.dynamics import Dynamics
from ahnn.dynamics.variations import own_jacobians
from ahnn.measurements import Segment
from ahnn.measurements.noise_estimate import NoiseEstimate, UnknownNoise
from ahnn.shooting.initial_states import Trial, linearised
from ahnn.shooting.robust import FREEDOM, ROBUST, RobustName, loss_of
from ahnn.training.laplace import conclude
from ahnn.training.maximum_posterior import whole_problem
from ahnn.training.noise_likelihood import FoundNoise, Residuals, most_likely
from ahnn.training.student_likelihood import FoundTails, most_likely_tails, without_fit
from ahnn.uncertainty import Uncertainty

log = logging.getLogger("ahnn")

ROUNDS = 3
"""Maximum number of fits."""
SETTLED = 0.05
"""Relative change of a standard deviation, fraction or memory below which no further fit is made."""
PATHS, SAMPLES = 100, 400
"""Maximum numbers of trajectories, and of measurements of each, for the noise estimate."""
NO_NOISE = 10.0
"""Ratio to the previous standard deviations above which residuals are errors of the dynamics, not noise."""
FAR = 6.0
"""Number of robust standard deviations beyond which residuals are omitted if the loss is robust."""


@torch.no_grad()
def conclude_with_noise(
    dynamics: Dynamics,
    train: Segment,
    held_out: Segment,
    steps: int,
    robust: RobustName,
    unknown: UnknownNoise,
) -> tuple[Uncertainty | None, NoiseEstimate | None]:
    """Take the final steps like `conclude`, and also return the estimate of unknown noise."""
    if not unknown.anything:
        return conclude(dynamics, train, held_out, steps, robust), None
    stated = train.instrument.deviations
    begin = noise = FoundNoise(torch.ones_like(stated), None)
    found: Uncertainty | None = None
    instrument = train.instrument._replace(bias_sd=unknown.bias_sd)
    if unknown.tails:  # the first fit must be robust to outliers
        instrument = instrument._replace(freedom=torch.full_like(stated, FREEDOM))
    for done in range(ROUNDS):
        train, held_out = (part._replace(instrument=instrument) for part in (train, held_out))
        again = conclude(dynamics, train, held_out, steps, robust)
        if again is None:
            break
        found, before, noise = again, noise, begin
        instrument = instrument._replace(bias=biases_of(found))
        if unknown.tails:
            train = train._replace(instrument=instrument)
            noise = heavy_tailed(found.taken(dynamics)[0], train, robust, found.about["determined"], stated)
        elif unknown.sizes or unknown.correlation:
            train = train._replace(instrument=instrument._replace(deviations=stated, colour=None))
            noise = estimated(found.taken(dynamics)[0], train, robust, found.about["determined"], unknown)
        if noise is not begin and not is_noise(noise, found.about["chi_square"]):
            noise = begin
            break
        instrument = instrument._replace(
            deviations=stated * noise.scales, colour=noise.colour, freedom=noise.freedom
        )
        if alike(before, noise) and (done or not unknown.tails):  # the first tails were assumed
            break
    return found, None if found is None else written(found, noise, stated, unknown)


def is_noise(noise: FoundNoise, chi_square: float) -> bool:
    """Return whether the residuals of a fit can be noise; logs a warning if not."""
    times = max(float(noise.scales.max()), chi_square**0.5)
    if times > NO_NOISE:
        log.warning(
            "the noise is not estimated: residuals are %.2g times the expected noise, probably due to errors "
            "in the dynamics. Train longer, or set data.noise",
            times,
        )
    return times <= NO_NOISE


def biases_of(found: Uncertainty) -> Tensor | None:
    """Return the biases (M,) found by a fit; None if none was unknown."""
    given = found.about.get("bias")
    return None if given is None else torch.tensor(given, dtype=torch.float64)


def estimated(
    dynamics: Dynamics, train: Segment, robust: RobustName, determined: float, unknown: UnknownNoise
) -> FoundNoise:
    """Return the most likely noise of residuals about paths of learned dynamics.

    Args:
        dynamics: float64 dynamics fitted to all measurements.
        train: training segments with the stated white noise.
        robust: the loss of the fit.
        determined: number of parameters determined by the measurements; their fit makes the residuals
            smaller.
        unknown: noise parameters to be estimated.
    """
    some = train.first(SAMPLES).rows(slice(None, None, -(-len(train.times) // PATHS)))
    problem = whole_problem(dynamics, some, ROBUST[robust])
    states, segment, steps = problem.fitted.states[problem.kept], problem.batch, problem.steps
    now = linearised(
        Trial(dynamics.increment, own_jacobians(dynamics), ROBUST["none"]), states, segment, steps
    )
    there = ~segment.values.isnan()
    if robust != "none":
        typical = now.residuals.abs().where(there, torch.nan).flatten(0, 1).nanmedian(0).values / NORMAL
        there &= now.residuals.abs() <= FAR * typical
    left = Residuals(now.residuals * there, now.of_start * there.unsqueeze(-1), segment.times, there)
    noise = most_likely(left, sizes=unknown.sizes, correlation=unknown.correlation)
    if unknown.sizes:
        count = float(train.measured.sum()) - 2 * train.instrument.dof * len(train.times)
        noise = noise._replace(scales=noise.scales * (count / max(count - determined, 1.0)) ** 0.5)
    return noise


def heavy_tailed(
    dynamics: Dynamics, train: Segment, robust: RobustName, determined: float, stated: Tensor
) -> FoundNoise:
    """Return the most likely Student's noise of residuals about paths of learned dynamics.

    Args:
        dynamics: float64 dynamics fitted to all measurements.
        train: training segments, with the noise used in the fit.
        robust: the loss of the fit if the noise of all components is normal.
        determined: number of parameters that the measurements determine.
        stated: stated standard deviations, (M,).
    """
    some = train.rows(slice(None, None, -(-len(train.times) // PATHS)))
    freedom = train.instrument.freedom
    problem = whole_problem(dynamics, some, loss_of(robust, freedom))
    segment, states = problem.batch, problem.fitted.states[problem.kept]
    trial = Trial(dynamics.increment, own_jacobians(dynamics), problem.robust)
    of_start = linearised(trial, states, segment, problem.steps).of_start
    left = without_fit(segment.residuals(states[:, problem.steps.ends]), of_start, freedom)
    count = float(train.measured.sum()) - 2 * train.instrument.dof * len(train.times)
    left = left * train.instrument.deviations / stated * (count / max(count - determined, 1.0)) ** 0.5
    there = ~segment.values.isnan()
    tails = tuple(most_likely_tails(left[..., k][there[..., k]]) for k in range(left.shape[-1]))
    return FoundNoise(torch.tensor([one.scale for one in tails]).to(stated), None, tails)


def alike(one: FoundNoise, other: FoundNoise) -> bool:
    """Return whether two estimates of noise lead to the same fit."""
    flat = [torch.cat((noise.scales.log(), _rates(noise), *_parts(noise))) for noise in (one, other)]
    return float((flat[0] - flat[1]).abs().max()) < SETTLED


def _rates(noise: FoundNoise) -> Tensor:
    """Return the inverse degrees of freedom, (M,), 0 for normal noise."""
    return torch.zeros_like(noise.scales) if noise.freedom is None else 1 / noise.freedom


def _parts(noise: FoundNoise) -> tuple[Tensor, Tensor]:
    """Return the coloured fractions and the logarithms of the memories, (M,), 0 where noise is white."""
    none = torch.zeros_like(noise.scales)
    if noise.colour is None:
        return none, none
    return noise.colour.fractions, noise.colour.memories.log().where(noise.colour.fractions > SETTLED, 0.0)


def written(found: Uncertainty, noise: FoundNoise, stated: Tensor, unknown: UnknownNoise) -> NoiseEstimate:
    """Return the estimate in the form stored with weights."""
    colour, size = noise.colour, len(stated)
    fractions, memories = (
        ([0.0] * size, [1.0] * size) if colour is None else (part.tolist() for part in colour)
    )
    prior, about = unknown.bias_sd, found.about
    return NoiseEstimate(
        deviations=(stated * noise.scales).tolist(),
        stated=stated.tolist() if unknown.sizes or unknown.tails else [],
        fractions=fractions if unknown.correlation else [],
        memories=memories if unknown.correlation else [],
        bias=about["bias"] if prior is not None else [],
        bias_sd=about["bias_sd"] if prior is not None else [],
        prior_sd=[] if prior is None else prior.tolist(),
        **of_tails(noise.tails, stated),
    )


def of_tails(tails: tuple[FoundTails, ...] | None, stated: Tensor) -> dict[str, list[float]]:
    """Return the fields of `NoiseEstimate` that describe tails; infinite values become 0."""
    if tails is None:
        return {}
    finite = lambda value: value if math.isfinite(value) else 0.0  # noqa: E731
    return {
        "freedom": [finite(tail.freedom) for tail in tails],
        "freedom_low": [tail.low for tail in tails],
        "freedom_high": [finite(tail.high) for tail in tails],
        "scale_sd": [finite(tail.scale_sd * float(sd)) for tail, sd in zip(tails, stated, strict=True)],
    }
