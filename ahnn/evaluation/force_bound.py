"""Cramer-Rao bound of the true force model with unknown constants and initial states.

Residuals r(theta, x_0) in standard deviations have the Fisher information J^T J. With the initial states of
all trajectories eliminated it is

    I = sum over trajectories of J_theta^T (1 - J_x J_x^+) J_theta,

and no unbiased estimate of theta has a covariance below I^-1 (Kay 1993, Fundamentals of Statistical Signal
Processing: Estimation Theory, section 3.7). Derivatives are central differences along the exact flow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.dynamics.derivatives import knows_velocities
from ahnn.evaluation.bands import norms
from ahnn.evaluation.case import Case
from ahnn.labels import quantity
from ahnn.measurements import Segment
from ahnn.metrics import errors
from ahnn.rollouts import rollout
from ahnn.shooting.robust import informative
from ahnn.systems import System
from ahnn.systems.truth import varied_flow
from ahnn.types import Space

STEP = 1e-6
"""Step of central differences, relative to a constant, or to the largest position or momentum of a start."""
TRAJECTORIES = 64
"""Maximum number of evenly chosen trajectories that represent a split."""
UNSEEN = 1e-9
"""Relative singular value of a start's derivatives below which it is treated as zero."""

Prediction = Callable[[Tensor, Tensor], Tensor]
"""(constants (R, P), starts (R, D)) -> results for each pair, (R, ...)."""


class ForceBound(NamedTuple):
    """Smallest errors attainable if the form of the true force is known.

    Attributes:
        constants: names of the unknowns besides the initial states.
        deviations: standard deviations of the constants, as fractions of their values.
        bound: rms norms of the errors of positions and velocities of rollouts from the true start.
        efficiency: rms norms of the model's errors in units of the bound.
    """

    constants: tuple[str, ...]
    deviations: tuple[float, ...]
    bound: tuple[float, float]
    efficiency: tuple[float, float]

    def sentence(self, space: Space) -> str:
        """Return the finding as a note under the table."""
        second, _ = quantity(space, "velocity")
        return (
            f"the error from the true start is {self.efficiency[0]:.3g} (position) and "
            f"{self.efficiency[1]:.3g} ({second}) times the bound for the true force with unknown "
            f"{', '.join(self.constants)} and initial states"
        )

    def numbers(self) -> dict[str, Any]:
        """Return plain values for metrics.json."""
        return {name: list(value) for name, value in self._asdict().items()}


def unknown_constants(system: System, dynamics: object) -> tuple[str, ...]:
    """Return the declared constants of a system, and its mass if velocities are also learned.

    Constants of value 0 have no effect and are omitted.
    """
    field: Any = getattr(dynamics, "field", None)
    mass = () if field is not None and knows_velocities(field) else ("mass",)
    declared = type(system).constants
    return tuple(name for name in (*declared, *mass) if getattr(system, name)) if declared else ()


@torch.no_grad()
def force_bound(case: Case, prediction: Tensor) -> ForceBound | None:
    """Compare the bound with the errors of a prediction (B, T, D) of the test trajectories.

    Outliers are treated as normal measurements, which makes the bound slightly too low.

    Returns:
        None if the true force, its constants or the training measurements are unknown, or if the constants
        are not determined.
    """
    system, seen = case.truth, case.learned_from
    names = () if system is None else unknown_constants(system, case.flow)
    if system is None or seen is None or not names:
        return None
    rows = chosen(len(seen.times))
    found = information_of(system, names, case.train.states[rows, 0], seen.rows(rows))
    factor, failed = torch.linalg.cholesky_ex(found * (len(seen.times) / len(rows)))
    if int(failed):
        return None
    covariance = torch.cholesky_inverse(factor)
    off = errors(prediction, case.test.states)
    bound = norms(rollout_deviations(case, system, names, covariance), case.space.divisor)
    real = norms(off, case.space.divisor)
    return ForceBound(
        constants=names,
        deviations=tuple(covariance.diagonal().sqrt().tolist()),
        bound=bound,
        efficiency=(real[0] / bound[0], real[1] / bound[1]),
    )


def information_of(system: System, names: Sequence[str], start: Tensor, segment: Segment) -> Tensor:
    """Return the information (P, P) of measurements about the logarithms of a system's constants.

    Args:
        system: system that was measured.
        names: names of its P constants.
        start: (B, D) true states at the first times of the segment.
        segment: measurements; only the pattern of missing values is used.
    """
    gaps = segment.times.diff(dim=1).nan_to_num(0.0)  # no times exist beyond the end of a trajectory
    root_weight = informative(segment.instrument.freedom).weight(segment.instrument.deviations).sqrt()

    def residuals(constants: Tensor, x: Tensor) -> Tensor:
        copies = len(x) // len(start)
        states = varied_rollout(system, names, constants, x, gaps.repeat(copies, 1))
        again = segment.rows(torch.arange(len(start)).repeat(copies))
        return (again.white_residuals(states) * root_weight).flatten(1)

    of_constants, of_start = derivatives(residuals, constants_of(system, names), start)
    return information(of_constants, of_start)


def information(of_constants: Tensor, of_start: Tensor) -> Tensor:
    """Return the information (P, P) about P constants, with the initial states of B trajectories eliminated.

    Args:
        of_constants: derivatives of residuals in standard deviations, (B, R, P).
        of_start: derivatives with respect to the initial state, (B, R, D).
    """
    basis, sizes, _ = torch.linalg.svd(of_start, full_matrices=False)
    basis = basis * (sizes > UNSEEN * sizes[:, :1]).unsqueeze(1)
    left = of_constants - basis @ (basis.mT @ of_constants)
    return (left.mT @ left).sum(0)


def rollout_deviations(case: Case, system: System, names: Sequence[str], covariance: Tensor) -> Tensor:
    """Return standard deviations (B', T, D) of rollouts from true starts; NaN where the truth is missing."""
    states = evenly(case.test.states)
    start, samples = states[:, 0], states.shape[1]
    gaps = torch.as_tensor(case.dt, dtype=torch.float64)
    gaps = evenly(gaps.expand(len(case.test.states), samples - 1)).nan_to_num(0.0)

    def flown(constants: Tensor, x: Tensor) -> Tensor:
        return varied_rollout(system, names, constants, x, gaps.repeat(len(x) // len(start), 1))

    slopes, _ = derivatives(flown, constants_of(system, names), start, of_starts=False)
    variance = torch.einsum("...p,pq,...q->...", slopes, covariance, slopes)
    return variance.clamp(min=0).sqrt().where(states.isfinite(), torch.nan)


def derivatives(
    predict: Prediction, constants: Tensor, start: Tensor, *, of_starts: bool = True
) -> tuple[Tensor, Tensor]:
    """Return central differences with respect to log constants (B, ..., P), and to starts (B, ..., D).

    Starts are scaled by their largest position and momentum. All differences are formed in one batch.

    Args:
        predict: function to differentiate.
        constants: (P,) values.
        start: (B, D) initial states.
        of_starts: whether to include derivatives with respect to starts; otherwise they have no columns.
    """
    count, size, width = len(start), len(constants), start.shape[1] if of_starts else 0
    blocks = start.unflatten(-1, (2, -1)).abs().amax((0, 2), keepdim=True)
    unit = blocks.expand(1, 2, start.shape[1] // 2).flatten()
    unit = torch.where(unit > 0, unit, torch.ones_like(unit))
    moves = STEP * torch.eye(size + width).to(start)
    moves = torch.cat((moves, -moves))
    values = constants * (1 + moves[:, :size])
    states = start + pad_to(moves[:, size:], start.shape[1]).unsqueeze(1) * unit
    found = predict(values.repeat_interleave(count, 0), states.flatten(0, 1)).unflatten(0, (2, -1, count))
    slopes = ((found[0] - found[1]) / (2 * STEP)).movedim(0, -1)
    return slopes[..., :size], slopes[..., size:]


def pad_to(moves: Tensor, width: int) -> Tensor:
    """Pad displacements with zeros to a number of columns."""
    return torch.nn.functional.pad(moves, (0, width - moves.shape[1]))


def varied_rollout(
    system: System, names: Sequence[str], constants: Tensor, start: Tensor, gaps: Tensor
) -> Tensor:
    """Propagate starts (R, D) over steps (R, N) with constants (R, P) per row; return (R, N + 1, D)."""
    flow = varied_flow(system, dict(zip(names, constants.unsqueeze(-1).unbind(1), strict=True)))
    return rollout(flow, start, gaps, gaps.shape[1] + 1)


def constants_of(system: System, names: Sequence[str]) -> Tensor:
    """Return the values of a system's constants, (P,)."""
    return torch.tensor([getattr(system, name) for name in names], dtype=torch.float64)


def chosen(count: int) -> Tensor:
    """Return the indices of representative trajectories."""
    return torch.linspace(0, count - 1, min(count, TRAJECTORIES)).round().long()


def evenly(values: Tensor) -> Tensor:
    """Return the rows of representative trajectories."""
    return values[chosen(len(values))]
