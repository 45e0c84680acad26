"""The weak form: a field held against noisy states by integrals, without differences and without a solver.

For a function phi that vanishes at both ends of a span, the integral of phi dx/dt is that of -phi' x. So

    r = integral of (phi f(x) + phi' x) dt

is zero for the true field f, and its noise is that of a weighted sum of samples (Messenger & Bortz 2021,
Multiscale Model. Simul. 19, 1474-1497). It is linear in the field.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, cast

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.dynamics import Dynamics, HasField
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.errors import UserError
from ahnn.measurements import Segment, State
from ahnn.shooting.robust import ROBUST, Robust, RobustName
from ahnn.training.normal_equations import Equations, Rows, accumulated

POWER = 8
"""Of phi = (1 - u^2)^p: so many derivatives vanish at its ends, where sums then equal integrals."""
NARROWEST = 10
"""Samples in half a span, at least: over fewer the sums are no integrals, however little the noise."""
PER_WIDTH = 3
"""Test functions that begin within half a span."""
UNEVEN = 3.0
"""Ratio of neighbouring steps beyond which straight lines are trusted more than a parabola."""
CELLS = 1e8
"""Numbers in the largest tensor of sensitivities; longer batches are cut into parts of segments."""


class Tests(NamedTuple):
    """Test functions of some segments, times the weights of a rule of integration.

    Attributes:
        stride: samples between the first ones of neighbouring spans.
        values: phi over its span of S samples, (B, J, S); B may be 1 for all alike.
        slopes: phi', (B, J, S).
        whiten: (B, J, J) that makes the noise of the integrals white; 0 for one with a missing sample.
    """

    stride: int
    values: Tensor
    slopes: Tensor
    whiten: Tensor

    def rows(self, part: slice) -> Tests:
        """Return those of some segments."""
        if len(self.values) == 1:
            return self
        return Tests(self.stride, self.values[part], self.slopes[part], self.whiten[part])


def integrated(weights: Tensor, stride: int, samples: Tensor) -> Tensor:
    """Return the sums over each span of weights (B, J, S) times samples (B, K + 1, M), shape (B, J, M).

    Span j begins with the sample j x stride.
    """
    reach = stride * (weights.shape[1] - 1) + 1
    total = weights[..., :1].to(samples) * samples[:, :reach:stride]
    for offset in range(1, weights.shape[-1]):
        of_each = samples[:, offset : offset + reach : stride]
        total.addcmul_(weights[..., offset, None].to(samples), of_each)
    return total


def bumps(times: Tensor, present: Tensor, width: int) -> Tests:
    """Return test functions over spans of 2 x width intervals, or of all of them if these are fewer.

    Args:
        times: (B, K + 1).
        present: (B, K + 1) bool, whether a sample is there.
        width: half of a span, in samples, of which there are at least `NARROWEST` where data reach so far.
    """
    last = times.shape[1] - 1
    width = max(1, min(max(width, NARROWEST), last // 2))
    stride = max(1, width // PER_WIDTH)
    begins = torch.arange(0, last - 2 * width + 1, stride)
    spans = begins.unsqueeze(-1) + torch.arange(2 * width + 1)
    of_span = times[:, spans]
    half = (of_span[..., -1:] - of_span[..., :1]) / 2
    u = ((of_span - of_span[..., :1]) / half - 1).clamp(-1, 1)
    weights, bump = quadrature(times)[:, spans], 1 - u * u
    values = weights * bump**POWER
    slopes = weights * (-2 * POWER * u * bump ** (POWER - 1) / half)
    missing = ((values != 0) & ~present[:, spans]).any(-1)
    return Tests(stride, values, slopes, whitening(spans, slopes, missing))


def whitening(spans: Tensor, slopes: Tensor, missing: Tensor) -> Tensor:
    """Return W, (B, J, J), so that W sums of independent noise over the spans are independent.

    Args:
        spans: (J, S) the samples of each sum.
        slopes: (B, J, S) their weights.
        missing: (B, J) bool, sums that are not there; their rows and columns are zero.
    """
    everywhere = slopes.new_zeros(*slopes.shape[:2], int(spans.max()) + 1)
    everywhere = everywhere.scatter(-1, spans.expand_as(slopes), slopes)
    covariance = everywhere @ everywhere.mT
    one = torch.eye(covariance.shape[-1]).to(covariance)
    apart = missing.unsqueeze(-1) | missing.unsqueeze(-2)
    factor = torch.linalg.cholesky(torch.where(apart, one, covariance))
    whiten = torch.linalg.solve_triangular(factor, one.expand_as(factor), upper=False)
    return whiten * ~missing.unsqueeze(-2) * ~missing.unsqueeze(-1)


def quadrature(times: Tensor) -> Tensor:
    """Return the weights (B, K + 1) of sums that are integrals of what vanishes at both ends, and beyond.

    Simpson's rule over every two neighbouring steps, halved. At equal steps all weights are equal, and sums
    of smooth functions exact to high order; at others the trapezoidal rule would be of second order.
    """
    steps = times.diff(dim=1)
    steps = torch.cat((steps[:, :1].expand(-1, 2), steps, steps[:, -1:].expand(-1, 2)), dim=1)
    a, b = steps[:, :-1], steps[:, 1:]
    left = a * (2 * a + 3 * b) - b**3 / a
    right = b * (2 * b + 3 * a) - a**3 / b
    uneven = torch.maximum(a / b, b / a) > UNEVEN
    left, right = (
        torch.where(uneven, own / 2, found / (6 * (a + b))) for own, found in ((a, left), (b, right))
    )
    middle = a + b - left - right
    return (left[:, 2:] + middle[:, 1:-1] + right[:, :-2]) / 2


@dataclass(frozen=True, eq=False)
class Weak:
    """Integrals of the field against test functions, in standard deviations of their noise.

    Attributes:
        robust: the loss of single residuals: none (squares), huber or student.
    """

    robust: RobustName = "none"
    intervals: ClassVar[None] = None  # whole trajectories

    def residuals(self, dynamics: Dynamics, batch: Segment) -> Tensor:
        """Return the weighted residuals, shape (B, J, D), with a graph."""
        problem = self.problem(dynamics, batch)
        residuals = problem.integrals(cast(HasField, dynamics).field, slice(None))
        return residuals * problem.robust.weight(residuals.detach()).sqrt()

    def problem(self, dynamics: Dynamics, batch: Segment) -> WeakProblem:
        """Return the same residuals as a problem in the parameters of the dynamics."""
        return WeakProblem(dynamics, batch, ROBUST[self.robust])

    def divided(self, batch: Segment) -> tuple[Segment, None]:
        """Return the whole batch to step on."""
        return batch, None

    def validation(self, dynamics: Dynamics, batch: Segment) -> dict[str, Tensor]:
        """Return chi-square per degree of freedom."""
        problem = self.problem(dynamics, batch)
        return {"loss": problem.loss(parameters_to_vector(dynamics.parameters()).detach()) / problem.count}


class WeakProblem:
    """Integrals of noisy states as a problem in the parameters theta, shape (P,), of dynamics with a field.

    Raises:
        UserError: measurements that are no states, or dynamics without a field.
    """

    def __init__(self, dynamics: Dynamics, batch: Segment, robust: Robust) -> None:
        if not isinstance(batch.instrument.measurement, State) or not isinstance(dynamics, HasField):
            message = (
                "loss.stages: weak expects measured states and dynamics with a field; received "
                f"{type(batch.instrument.measurement).__name__} and {type(dynamics).__name__}. "
                "Begin with stretches, such as [[4, 0.5], [whole, 1.0]]"
            )
            raise UserError(message)
        self.batch, self.robust = batch, robust
        self._exact = copy.deepcopy(dynamics).requires_grad_(False)
        self._forcing = field_jacobian(dynamics)
        present = batch.values.isfinite().all(-1)
        times = batch.times - batch.times[:, :1]
        alike = bool((times - times[:1]).abs().max() <= 1e-9 * times.max()) and bool(present.all())
        kept = slice(1) if alike else slice(None)
        self.tests = bumps(times[kept], present[kept], batch.instrument.width)
        self.values = batch.values.nan_to_num(0.0)
        used = (self.tests.whiten.diagonal(dim1=1, dim2=2) != 0).sum()
        self.count = int(used) * self.values.shape[-1] * (len(self.values) if alike else 1)

    def integrals(self, field: torch.nn.Module, part: slice) -> Tensor:
        """Return the whitened integrals (B, J, D) of some of the segments."""
        tests, x = self.tests.rows(part), self.values[part]
        sums = integrated(tests.values, tests.stride, field(x)) + integrated(tests.slopes, tests.stride, x)
        return tests.whiten @ sums / self.batch.instrument.deviations.to(x)

    def _parts(self, numbers: int) -> Iterator[slice]:
        rows = max(1, int(CELLS // (self.values.shape[1] * self.values.shape[2] * numbers)))
        return (slice(k, k + rows) for k in range(0, len(self.values), rows))

    def _at(self, theta: Tensor) -> torch.nn.Module:
        vector_to_parameters(theta, self._exact.parameters())
        return cast(HasField, self._exact).field

    @torch.no_grad()
    def loss(self, theta: Tensor) -> Tensor:
        """Return the sum of squared residuals."""
        field = self._at(theta)
        parts = [self.robust.cost(self.integrals(field, part)).sum() for part in self._parts(50)]
        return torch.stack(parts).sum()

    @torch.no_grad()
    def equations(self, theta: Tensor, sizes: Sequence[int]) -> Equations:
        """Return loss and normal equations."""
        del sizes
        field = self._at(theta)
        return accumulated(
            (self._rows(theta, field, part) for part in self._parts(len(theta))), theta, self.count
        )

    def _rows(self, theta: Tensor, field: torch.nn.Module, part: slice) -> Rows:
        """Return the residuals of some segments and their Jacobian, float32."""
        plain = self.integrals(field, part)
        weight = self.robust.weight(plain).sqrt()
        tests, x = self.tests.rows(part), self.values[part]
        forcing = self._forcing(theta, x)  # (B, K + 1, L, P): of the last L components, which parameters move
        sums = integrated(tests.values, tests.stride, forcing.flatten(2))
        sums = (tests.whiten.float() @ sums).unflatten(-1, forcing.shape[2:])
        moved = slice(x.shape[-1] - forcing.shape[2], None)
        residuals, weight = plain[..., moved], weight[..., moved]
        scale = (weight / self.batch.instrument.deviations[moved].to(weight)).float()
        jacobian = sums.mul_(scale.unsqueeze(-1)).flatten(0, 2)
        return Rows(self.robust.cost(plain).sum(), (weight * residuals).flatten(), jacobian)
