"""Propagation of initial states to given times, with covariance and novelty.

The covariance follows `ahnn.uncertainty.rollout_covariances`, includes the uncertainty of the start, and is
propagated in segments so that any duration fits into memory. Outside the training data, the sensitivity of
the field to its parameters is multiplied by `growth`: the error of a learned force grows there faster than
its parameter covariance implies.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor

from ahnn.clock import Clock
from ahnn.deviations import require_finite
from ahnn.dynamics import Dynamics, HasField
from ahnn.errors import UserError
from ahnn.memory import require_memory
from ahnn.prediction.followed_path import FollowedPath, Knowledge
from ahnn.prediction.sampled_prediction import path_samples, require_samples
from ahnn.progress import track
from ahnn.shooting.path_sensitivities import Steps, path, steps_between
from ahnn.shooting.quadrature import coarse
from ahnn.types import in_short
from ahnn.uncertainty import (
    LINEAR,
    asymmetry,
    joint_nonlinearity,
    largest_displacement,
    mixture_moments,
    nonlinearity,
)
from ahnn.uncertainty.linear_range import THIN, IntervalFlow

CELLS = 4e6
"""Size limit of the largest sensitivity tensor; longer paths are propagated in segments."""

INTERVALS = 32
"""Approximate number of intervals of a path, at whose ends the index of nonlinearity is calculated."""

CURVED = 10.0
"""Safety factor of the criterion by which no index of nonlinearity is calculated."""

TOGETHER = 2_000
"""Number of states per segment, after which the progress bar is updated."""


class Prediction(NamedTuple):
    """Predicted trajectories.

    Attributes:
        times: (T,) times; the first is that of the starts.
        states: (B, T, D) predicted states.
        covariances: (B, T, D, D) covariances, or None if unknown.
        novelty: (B, T) distance from the training data, scaled to 1 at its edge; None if unknown.
        nonlinearity: (B, T) index of nonlinearity of the errors (`ahnn.uncertainty.nonlinearity`), up to
            `ahnn.uncertainty.LINEAR` where first-order covariances are valid; 0 where they are small, None if
            unknown.
        samples: (B, T, S, D) sampled paths, whose means and covariances are the states and covariances; None
            for first-order covariances.
        joint_nonlinearity: (B, T) the index of the joint covariance (`ahnn.uncertainty.joint_nonlinearity`).
    """

    times: Tensor
    states: Tensor
    covariances: Tensor | None = None
    novelty: Tensor | None = None
    nonlinearity: Tensor | None = None
    samples: Tensor | None = None
    joint_nonlinearity: Tensor | None = None

    def __repr__(self) -> str:
        return in_short(self)

    @property
    def deviations(self) -> Tensor | None:
        """Standard deviations of the states, (B, T, D)."""
        return None if self.covariances is None else self.covariances.diagonal(dim1=-2, dim2=-1).sqrt()

    def at(self, chosen: Tensor, times: Tensor) -> Prediction:
        """Return selected samples, (K,), with given times."""
        return Prediction(times, *(None if part is None else part[:, chosen] for part in self[1:]))  # pyright: ignore[reportArgumentType]


@torch.no_grad()
def predicted(
    dynamics: Dynamics,
    start: Tensor,
    times: Tensor,
    longest: float,
    known: Knowledge = Knowledge(),  # noqa: B008 - a tuple
    description: str | None = None,
    clock: Clock | None = None,
    samples: int = 0,
) -> Prediction:
    """Predict states at given times.

    Args:
        dynamics: float64 dynamics.
        start: (B, D) states at the first of the times.
        times: (T,) increasing.
        longest: maximum integrator step; intervals are divided into the fewest equal steps.
        known: uncertainty information.
        description: text of the progress bar; None: no bar.
        clock: time and controls at the times, (T, k) or (B, T, k); None for autonomous dynamics.
        samples: number of sampled paths, whose moments replace those of first order; 0: none.

    Raises:
        UserError: starts that are not finite, times that do not increase, samples of what is exact, or
            insufficient memory.
    """
    require_times(times)
    require_finite(start)
    require_room(len(start), start.shape[1], times, longest)
    if samples:
        require_samples(samples, start.numel() * len(times), known)
    require_memory("start", "sensitivities of states", 4.0 * INTERVALS * start.numel() * known.columns)
    found = _followed(FollowedPath(dynamics, known), start, times, longest, description, clock)
    if not samples:
        return found
    paths = path_samples(dynamics, start, times, longest, known, samples, description, clock)
    mean, covariances = mixture_moments(paths.movedim(2, 0))
    return found._replace(states=mean, covariances=covariances, samples=paths)


@torch.no_grad()
def prediction_factors(
    dynamics: Dynamics, start: Tensor, times: Tensor, longest: float, known: Knowledge
) -> tuple[Tensor, Tensor]:
    """Return predicted states (T, D) and factors (T, D, R) of their covariances, both float64.

    The R columns are independent causes of unit variance: first those of the parameters, then of the start.

    Args:
        dynamics: float64 dynamics.
        start: (D,) state at the first of the times.
        times: (T,) increasing.
        longest: maximum integrator step.
        known: uncertainty information, at least on the start or the parameters.

    Raises:
        UserError: the same errors as `predicted`.
    """
    require_times(times)
    require_finite(start)
    require_memory("times", "sensitivities of states", 8.0 * len(times) * len(start) * known.columns)
    path = FollowedPath(dynamics, known, factors=True)
    found = _followed(path, start.unsqueeze(0), times, longest)
    assert found.covariances is not None
    return found.states[0], found.covariances[0]


def _followed(
    paths: FollowedPath,
    start: Tensor,
    times: Tensor,
    longest: float,
    description: str | None = None,
    clock: Clock | None = None,
) -> Prediction:
    """Return the prediction at given times, computed in segments; with `factors`, without nonlinearity."""
    steps = steps_between(times.unsqueeze(0), longest)
    paths.quartered = paths.known.spread is not None and needs_quarters(paths.dynamics, start, steps)
    wanted = torch.zeros(int(steps.ends[-1]) + 1, dtype=torch.bool)
    wanted[steps.ends] = True
    cells = start.numel() * max(paths.known.columns, 1) * (4 if paths.quartered else 1)
    lengths = steps.lengths[0]
    fewest = -(-len(lengths) // INTERVALS) if paths.known.columns else len(lengths)
    size = max(1, min(int(CELLS // cells), TOGETHER // len(start), fewest))
    along = None if clock is None else clock.along(lengths, steps.ends)
    parts = list(torch.arange(len(lengths)).split(size))
    every = -(-len(parts) // INTERVALS)
    rows: list[Any] = [paths.begin(start)]
    nodes = [(paths.x, paths.moved)]
    for k, part in enumerate(track(parts, description, len(parts)) if description else parts, start=1):
        own = None if along is None else along.steps(part)
        chosen = wanted[1:][part]
        rows.append([None if x is None else x[:, chosen] for x in paths.follow(lengths[part], own)])
        if k % every == 0 or k == len(parts):
            nodes.append((paths.x, paths.moved))
    columns: Any = (None if xs[0] is None else torch.cat(xs, dim=1) for xs in zip(*rows, strict=True))
    found = Prediction(times, *columns)
    del rows  # their memory is needed below
    if paths.factors or not paths.known.columns:
        return found
    between = torch.arange(len(lengths)).split(size * every)

    def flow(k: int, x: Tensor) -> Tensor:
        return paths.end(x, lengths[between[k]], None if along is None else along.steps(between[k]))

    indices = node_nonlinearity(flow, *(torch.stack(column, dim=1) for column in zip(*nodes, strict=True)))
    single, joint = indices[..., -(-steps.ends // (size * every))]
    return found._replace(nonlinearity=single, joint_nonlinearity=joint)


def node_nonlinearity(flow: IntervalFlow, states: Tensor, columns: Tensor) -> Tensor:
    """Return both indices of nonlinearity (2, B, K) of states (B, K, D) with covariance factors (B, K, D, R).

    The first is that of single components, the second that of the joint covariance. Both are 0 without a
    calculation if all deviations are so small that they cannot leave the linear range.
    """
    columns = columns.double()
    deviations = columns.square().sum(-1).sqrt()
    if is_surely_linear(states, deviations):
        return torch.zeros_like(states[..., 0]).expand(2, -1, -1)
    moves = torch.einsum("bkdr,br->bkd", columns, largest_displacement(columns[:, -1]))
    bends = asymmetry(flow, states, moves)
    return torch.stack((nonlinearity(bends, deviations), joint_nonlinearity(bends, columns)))


def is_surely_linear(states: Tensor, deviations: Tensor) -> bool:
    """Return whether curved displacements remain within the bands, judged by the size of the motion.

    A displacement s along a curve of radius R deviates from its tangent by s^2 / 2R, which is compared with
    the smallest resolved standard deviation, all relative to the rms of each component.
    """
    relative = deviations[:, 1:] / states.square().mean(1, keepdim=True).sqrt()
    return bool((CURVED * relative.amax(-1).square() < LINEAR * THIN * relative.amin(-1)).all())


def needs_quarters(dynamics: Dynamics, start: Tensor, steps: Steps) -> bool:
    """Return whether the first `TOGETHER` steps from starts (B, D) are too long for the trapezoidal rule."""
    lengths = steps.lengths[:, :TOGETHER].expand(len(start), -1)
    return coarse(cast(HasField, dynamics).field, path(dynamics.increment, start, lengths), lengths)


def together(predictions: Sequence[Prediction]) -> Prediction:
    """Combine predictions of several runs: their mean, with a covariance that includes their spread.

    By the law of total covariance, it is the mean of the individual covariances, if all are known, plus the
    sample covariance of the states. Novelty and indices of nonlinearity are the maxima.
    """
    first, *others = predictions
    if not others:
        return first
    own = [one.covariances for one in predictions if one.covariances is not None]
    known = torch.stack(own) if len(own) == len(predictions) else None
    mean, covariances = mixture_moments(torch.stack([one.states for one in predictions]), known)
    drawn = [one.samples for one in predictions if one.samples is not None]
    paths = torch.cat(drawn, dim=2) if len(drawn) == len(predictions) else None

    def largest(values: Sequence[Tensor | None]) -> Tensor | None:
        known = [one for one in values if one is not None]
        return torch.stack(known).amax(0) if len(known) == len(values) else None

    return Prediction(
        first.times,
        mean,
        covariances,
        novelty=largest([one.novelty for one in predictions]),
        nonlinearity=largest([one.nonlinearity for one in predictions]),
        samples=paths,
        joint_nonlinearity=largest([one.joint_nonlinearity for one in predictions]),
    )


def require_times(times: Tensor) -> None:
    """Raise UserError for times that are not (T,), finite and increasing."""
    if times.ndim != 1 or len(times) < 2 or not bool((times.diff() > 0).all() & times.isfinite().all()):
        received = times.tolist() if times.numel() < 7 else f"shape {tuple(times.shape)}"
        message = f"times: expected two or more increasing times, the first at the start; received {received}"
        raise UserError(message)


def require_room(count: int, size: int, times: Tensor, longest: float) -> None:
    """Raise UserError if states (count, T, size) at times (T,) and their covariances exceed the memory."""
    numbers = count * len(times) * size * (size + 3) + float(times[-1] - times[0]) / longest
    require_memory("times", "predicted states", 8.0 * numbers)
