"""Final steps of training on measurements, and Laplace's approximation of the parameter covariance.

With all measurements in every step there is no mini-batch noise, and Gauss-Newton steps on residuals and
prior converge to the optimum. In parameter space they follow a curved valley in many short steps, so the last
steps are taken in function space (`ahnn.training.functions`). The covariance of the parameters is the inverse
of J^T J plus the prior precision, with initial states eliminated (Laplace's approximation). Three
corrections, which do not need the true dynamics, may widen it:

- chi-square of the training per degree of freedom, if it exceeds 1: the noise is larger than specified, or
  the model does not fit the data. For a robust loss the corresponding factor of that loss is used;
- the remaining step, as an additional error of the training;
- held-out measurements: if their residuals exceed both contributions, the least factor that they do not
  reject.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.data.segments import shortened
from ahnn.dynamics import Dynamics
from ahnn.measurements import Segment
from ahnn.progress import about, counted, foresee
from ahnn.shooting.robust import RobustName, loss_of
from ahnn.training.acceleration import accelerated
from ahnn.training.evidence import by_evidence
from ahnn.training.functions import ARRIVED, whole_step
from ahnn.training.least_observable import least_observable_directions
from ahnn.training.length_scales import choose_lengths
from ahnn.training.levenberg_marquardt import ATTEMPTS, LARGEST, SUFFICIENT, adapted
from ahnn.training.maximum_posterior import PosteriorPoint, WideProblem, after, whole_problem, with_prior
from ahnn.training.normal_equations import damped_step, promised_decrease
from ahnn.training.parameter_covariance import Noise, uncertainty
from ahnn.training.shared_bias import spread_over
from ahnn.uncertainty import Uncertainty
from ahnn.uncertainty.posterior import is_unfinished

log = logging.getLogger("ahnn")
AFTER = 5.5
"""Measured time of the closing stage after its first normal equations, in units of the time up to them."""
FINALLY = 2.7
"""Measured time of the closing stage after its last step, in the same units."""
DAMPING = 1e-6
"""Initial damping: float32 training determines directions only to a millionth of the best observable ones."""
FURTHER = 10
"""Maximum number of further steps of each kind if the training would otherwise end before its optimum."""
CONTINUED = 1.5
"""Measured time of further steps, relative to the closing stage before them (0.9 to 2.2 in five)."""
DIVISORS = (8, 4, 2)
"""Divisors of the trajectories' length for their segments, on which inaccurate paths stay near the data."""
UNEVEN = 10.0
"""Chi-square of the trajectory that fits worst, relative to the median, above which its path is lost."""
WORSE = 1.1
"""Maximum ratio of chi-squares after and before further steps that end nearer to the optimum."""
HARDER = 10.0
"""Factor on the damping after a step beyond the linear range."""


@torch.no_grad()
def conclude(
    dynamics: Dynamics, train: Segment, held_out: Segment, steps: int, robust: RobustName = "none"
) -> Uncertainty | None:
    """Take the final steps of the training and return the covariance of the resulting parameters.

    Args:
        dynamics: float64 dynamics with a field, updated in place.
        train: all training measurements.
        held_out: measurements not used by any step.
        steps: maximum number of steps.
        robust: robust loss of residuals.

    Returns:
        None if no trajectory is fitted; the parameters are then unchanged.
    """
    began = time.monotonic()
    choose_lengths(dynamics, train, loss_of(robust, train.instrument.freedom))
    found = _concluded(dynamics, train, held_out, steps, robust)
    if found is None:
        return None
    if is_unfinished(found.about) or found.about["uneven"] > UNEVEN:
        longer = about(CONTINUED * (time.monotonic() - began))
        log.info("the training has not reached its optimum: further steps follow, %s", longer)
        found = _continued(found, dynamics, train, held_out, robust)
    learned, known = found.taken(dynamics)  # fits of the trajectories may need this step
    uncertain, _ = known.tangent or (dynamics, known)
    return replace(
        found, directions=least_observable_directions(uncertain, found.spread, train, robust, learned)
    )


def _continued(
    found: Uncertainty, dynamics: Dynamics, train: Segment, held_out: Segment, robust: RobustName
) -> Uncertainty:
    """Take further steps on segments of increasing length and on trajectories.

    A training may be unfinished, or end at an optimum where some trajectories have lost their paths. Returns
    the better result.
    """
    before = parameters_to_vector(dynamics.parameters())
    for divisor in DIVISORS:
        _, here, gained = approached(dynamics, shortened(train, divisor), FURTHER, robust, enough=1.0)
        if here is None or min(here.remaining, gained) > here.determined:
            steps = 0  # even short segments are not fitted
            break
    else:
        steps = FURTHER
    again = _concluded(dynamics, train, held_out, steps, robust)
    if again is not None and _is_better(again.about, found.about):
        return again
    vector_to_parameters(before, dynamics.parameters())
    return found


def _is_better(after: Mapping[str, Any], before: Mapping[str, Any]) -> bool:
    """Return whether further steps reach an optimum, or come nearer to it, without a worse fit."""
    reached = not is_unfinished(after)
    fits = after["chi_square"] <= (WORSE if is_unfinished(before) else 1.0) * before["chi_square"]
    return fits and (reached or after["remaining"] <= before["remaining"])


def _concluded(
    dynamics: Dynamics, train: Segment, held_out: Segment, steps: int, robust: RobustName
) -> Uncertainty | None:
    loss, began = loss_of(robust, train.instrument.freedom), time.monotonic()
    problem, here, gained = approached(dynamics, train, steps, robust)
    first = time.monotonic() - began
    if here is None:
        return None
    unseen = whole_problem(dynamics, held_out, loss)
    others = unseen.equations(here.theta, [p.numel() for p in dynamics.parameters()])
    names = [name for name, _ in dynamics.named_parameters()]
    noise = Noise.of(problem, here.theta)
    taken = whole_step(problem, dynamics, here)
    foresee(FINALLY * first if steps == 0 else 0.0)
    if taken is None:
        there = here.left(gained) if gained <= ARRIVED * here.determined else here
        return with_biases(uncertainty(there, others, names, noise), problem)
    wide, there = taken
    others = others._replace(loss=after(unseen, wide).cost)
    found = replace(uncertainty(there, others, names, noise), step=there.theta - here.theta)
    return found if problem.shared is None else with_biases(found, after(problem, wide))


def with_biases(found: Uncertainty, problem: WideProblem) -> Uncertainty:
    """Add the sensor biases and their standard deviations to the result, if they are unknown."""
    if problem.shared is None:
        return found
    size = len(problem.batch.instrument.deviations)
    pull = problem.pull(problem.fitted.rows(problem.kept))
    best = problem.shared.best(pull, found.factor, found.inflation)
    named = zip(("bias", "bias_sd"), best, strict=True)
    biases = {name: spread_over(values, problem.shared.places, size).tolist() for name, values in named}
    return replace(found, about=found.about | biases)


def approached(
    dynamics: Dynamics, train: Segment, steps: int, robust: RobustName, enough: float = ARRIVED
) -> tuple[WideProblem, PosteriorPoint | None, float]:
    """Take parameter steps; return the final problem and point, and the last decrease.

    The steps end when the remaining one, or the last decrease, is `enough` relative to the noise.
    """
    parameters = list(dynamics.parameters())
    sizes = [p.numel() for p in parameters]
    began = time.monotonic()
    problem = whole_problem(dynamics, train, loss_of(robust, train.instrument.freedom))
    here = place(problem, parameters_to_vector(parameters), sizes)
    foresee(AFTER * (time.monotonic() - began) if steps == 0 else 0.0)
    damping, gained = DAMPING, float("inf")
    for _ in counted(steps, "step"):
        if here is None or min(here.remaining, gained) <= enough * here.determined:
            break
        theta, damping, decrease = lower(problem, here, damping)
        if theta is None:
            break
        gained = decrease
        vector_to_parameters(theta, parameters)
        if problem.lost:  # segments that failed to converge before may converge now
            problem = whole_problem(dynamics, train, problem.robust)
        else:
            problem.follow(theta)
        here = place(problem, theta, sizes)
    return problem, here, gained


def place(problem: WideProblem, theta: Tensor, sizes: Sequence[int]) -> PosteriorPoint | None:
    """Return the quadratic model at theta, shape (P,); None if no residual depends on theta."""
    loss, degrees, blocks = problem.equations(theta, sizes)
    if not blocks:
        return None
    (block,) = blocks
    return PosteriorPoint.of(theta, loss, degrees, block, by_evidence(block.matrix, theta, sizes))


def lower(problem: WideProblem, here: PosteriorPoint, damping: float) -> tuple[Tensor | None, float, float]:
    """Return parameters (P,) after a step that lowers residuals and prior, the damping, and the decrease.

    Parameters are None if no step lowers the objective.
    """
    block = with_prior(here.block, here.prior, here.theta)
    before = here.loss + here.prior.penalty(here.theta)
    for _ in range(ATTEMPTS):
        straight = damped_step([block], damping, here.theta)
        move = straight if straight is None else accelerated(problem, here.theta, [block], straight, damping)
        if straight is None or move is None:
            damping = min(damping * HARDER, LARGEST)
            continue
        theta = here.theta + move
        decrease = float(before - problem.loss(theta) - here.prior.penalty(theta))
        gain = decrease / float(promised_decrease([block], straight))
        accepted = gain > SUFFICIENT
        damping = adapted(damping, gain, 0.0, accepted)
        if accepted:
            return theta, damping, decrease
    return None, damping, 0.0
