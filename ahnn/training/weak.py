"""Weak form: comparison of a field with noisy states by integrals, without differences or solver.

For a test function phi that vanishes at both ends of a span, the integral of phi dx/dt equals the integral of
-phi' x. Hence

    r = integral of (phi f(x) + phi' x) dt

is zero for the true field f, and its noise is the noise of a weighted sum of samples (Messenger & Bortz 2021,
Multiscale Model. Simul. 19, 1474-1497). The residual is linear in the field. Measured positions q obey a
second-order equation, with -phi'' q instead of phi' x.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, cast

import torch
from torch import Tensor
from torch.func import vjp
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.cores import each, slices
from ahnn.dynamics import Dynamics, HasField
from ahnn.dynamics.derivatives import parametrised
from ahnn.dynamics.variations import jacobian_along, varied
from ahnn.errors import UserError
from ahnn.jacobians import TOGETHER, pointwise_jacobian
from ahnn.measurements import Segment
from ahnn.shooting.robust import ROBUST, Robust, RobustName
from ahnn.training.banded import BandedFactor
from ahnn.training.discrepancy import relative_error
from ahnn.training.equation_of_motion import equation_of_motion
from ahnn.training.normal_equations import Equations, ResidualRows, accumulated
from ahnn.training.weak_test_functions import bumps, integrated

Function = Callable[[Tensor], Tensor]
WIDTHS = {1: 3, 2: 2}
"""Half-width of a span, in lengths over which the motion is cubic, for each order of the equation: a bump is
small outside its middle third. With missing samples it is one length, since a gap excludes all spans that
contain it.
"""
CELLS = 1.4e7
"""Size limit of the largest sensitivity tensor; larger batches are divided by segments."""
SEGMENTS = 16
"""Number of segments whose covariances are factored at once."""


@dataclass(frozen=True, eq=False)
class Weak:
    """Integrals of the field against test functions, in standard deviations of their noise.

    Attributes:
        robust: robust loss of residuals: none (squares), huber or student.
        relative: whether to add the model discrepancy of the field to the noise. Used in early stages, far
            from the true field; once residuals are nearly noise, sums of many residuals are more informative
            without it.
    """

    robust: RobustName = "none"
    relative: bool = False
    intervals: ClassVar[None] = None  # full trajectories
    bends: ClassVar[bool] = True  # problems provide second derivatives of residuals

    def residuals(self, dynamics: Dynamics, batch: Segment) -> Tensor:
        """Return the weighted residuals, shape (B, J, D), with a graph."""
        problem = self.problem(dynamics, batch)
        residuals = problem.integrals(problem.motion.right(cast(HasField, dynamics).field), slice(None))
        return residuals * problem.robust.weight(residuals.detach()).sqrt()

    def problem(self, dynamics: Dynamics, batch: Segment) -> WeakProblem:
        """Return the residuals as a least-squares problem in the parameters of the dynamics."""
        return WeakProblem(dynamics, batch, ROBUST[self.robust], self.relative)

    def divided(self, batch: Segment) -> tuple[Segment, None]:
        """Return the entire batch for the step."""
        return batch, None

    def validation(self, dynamics: Dynamics, batch: Segment) -> dict[str, Tensor]:
        """Return chi-square per degree of freedom."""
        problem = self.problem(dynamics, batch)
        return {"loss": problem.loss(parameters_to_vector(dynamics.parameters()).detach()) / problem.count}


class WeakProblem:
    """Least-squares problem of weak-form integrals in the parameters theta, shape (P,), of a field.

    Raises:
        UserError: measurements whose equation of motion the field does not determine.
    """

    def __init__(self, dynamics: Dynamics, batch: Segment, robust: Robust, relative: bool = False) -> None:
        self.motion = equation_of_motion(dynamics, batch.instrument)
        self.batch, self.robust, self.relative = batch, robust, relative
        self._exact = copy.deepcopy(dynamics).requires_grad_(False)
        present = batch.values.isfinite().all(-1)
        times = batch.times - batch.times[:, :1]
        alike = bool((times - times[:1]).abs().max() <= 1e-9 * times.max()) and bool(present.all())
        kept = slice(1) if alike else slice(None)
        order = self.motion.order
        width = batch.instrument.width * (WIDTHS[order] if bool(present.all()) else 1)
        self.tests = bumps(times[kept], present[kept], width, order)
        anywhere = batch.values.nanmean(1, keepdim=True)  # for missing samples; sums with them are ignored
        self.values = torch.where(batch.values.isnan(), anywhere, batch.values)
        self.count = int(self.tests.there.sum()) * self.values.shape[-1] * (len(self.values) if alike else 1)
        if not self.count:
            message = (
                f"loss: expected, for the weak form, more than {2 * width} consecutive measurements of all "
                "components; received none. Choose recipe=measurements, which uses each measured component"
            )
            raise UserError(message)
        self.factor = self._factor()

    @torch.no_grad()
    def _factor(self) -> BandedFactor:
        """Return the covariance factor of the sums' noise and of the model discrepancy."""
        field = self.motion.right(cast(HasField, self._exact).field)
        if self.relative:  # an inaccurate field does not describe the propagation of noise
            nearest, *further = self._bands(slice(None), None)
            missed = self._missed(field, nearest.diagonal(dim1=-2, dim2=-1))
            return BandedFactor.of(
                [nearest + torch.diag_embed(missed * self.tests.there.unsqueeze(-1)), *further]
            )

        def of(part: slice) -> BandedFactor:
            return BandedFactor.of(self._bands(part, self._rates(part)))

        return BandedFactor.joined(each(of, slices(len(self.values), SEGMENTS), self.values.device))

    def _bands(self, part: slice, rates: Tensor | None) -> list[Tensor]:
        """Return the covariances of segments in the format of `BandedFactor.of`; 1 for missing sums."""
        tests, size = self.tests.rows(part), self.values.shape[-1]
        nearest, *further = tests.covariances(size, rates)
        missing = (~tests.there).unsqueeze(-1).expand(-1, -1, size)
        return [nearest + torch.diag_embed(missing.to(nearest)), *further]

    def _missed(self, field: Function, noise: Tensor) -> Tensor:
        """Return the discrepancy e^2 g^2, (B, J, D), with a separate e for each kind of quantity."""
        parts = [(self._sums(field, part), self._sums(None, part)) for part in self._parts(50)]
        kinds = self.motion.kinds
        sums, effects = (torch.cat(some).chunk(kinds, -1) for some in zip(*parts, strict=True))
        missed = []
        for residual, effect, variance in zip(sums, effects, noise.chunk(kinds, -1), strict=True):
            square = effect.square().mean(-1, keepdim=True).expand_as(residual)
            missed.append(relative_error(residual, square, variance, self.tests.there) ** 2 * square)
        return torch.cat(missed, -1)

    def _rates(self, part: slice) -> Tensor:
        """Return the derivatives of the field at samples, in standard deviations, (B, K + 1, D, D)."""
        x, field = self.values[part].flatten(0, 1), cast(HasField, self._exact).field
        along = varied(field)
        of_some = pointwise_jacobian if along is None else jacobian_along
        right = self.motion.right(field if along is None else along)
        rows = torch.cat([of_some(right, few) for few in x.split(TOGETHER // x.shape[1])])
        deviations = self.batch.instrument.deviations.to(x)
        return (rows * deviations / deviations.unsqueeze(-1)).unflatten(0, self.values[part].shape[:2])

    def _sums(self, field: Function | None, part: slice) -> Tensor:
        """Return the sums of segments in standard deviations, (B, J, D); without a field, of the data."""
        tests, x = self.tests.rows(part), self.values[part]
        sums = integrated(tests.on_data, tests.stride, x)
        if field is not None:
            sums = sums + integrated(tests.on_field, tests.stride, field(x))
        return sums * tests.there.unsqueeze(-1) / self.batch.instrument.deviations.to(x)

    def integrals(self, field: Function, part: slice) -> Tensor:
        """Return the whitened integrals (B, J, D) of selected segments."""
        return self.factor.rows(part).whiten(self._sums(field, part).unsqueeze(-1)).squeeze(-1)

    def _parts(self, numbers: int) -> Iterator[slice]:
        rows = max(1, int(CELLS // (self.values.shape[1] * self.values.shape[2] * numbers)))
        return (slice(k, k + rows) for k in range(0, len(self.values), rows))

    def _at(self, theta: Tensor) -> Function:
        vector_to_parameters(theta, self._exact.parameters())
        return self.motion.right(cast(HasField, self._exact).field)

    @torch.no_grad()
    def loss(self, theta: Tensor) -> Tensor:
        """Return the sum of squared residuals."""
        field = self._at(theta)
        parts = [self.robust.cost(self.integrals(field, part)).sum() for part in self._parts(50)]
        return torch.stack(parts).sum()

    @torch.no_grad()
    def equations(self, theta: Tensor, sizes: Sequence[int]) -> Equations:
        """Return loss and normal equations."""
        field = self._at(theta)
        return accumulated(
            lambda part: self._rows(theta, field, part), self._parts(len(theta)), theta, self.count
        )

    def bend(self, theta: Tensor, step: Tensor, reach: float) -> Tensor:
        """Return J^T r_vv of the weighted residuals, as in `ahnn.training.acceleration.Bends`."""
        total = torch.zeros_like(theta)
        for part in self._parts(50):
            whole = parametrised(self._exact, self._integrals_of(part), theta.dtype)
            here, pull = vjp(whole, theta)[:2]
            ahead, behind = whole(theta + reach * step), whole(theta - reach * step)
            second = (ahead - 2 * here + behind) / reach**2
            total = total + pull(self.robust.weight(here) * second)[0]
        return total

    def _integrals_of(self, part: slice) -> Callable[[], Tensor]:
        return lambda: self.integrals(self.motion.right(cast(HasField, self._exact).field), part)

    def _rows(self, theta: Tensor, field: Function, part: slice) -> ResidualRows:
        """Return the residuals of selected segments and their Jacobian."""
        plain = self.integrals(field, part)
        weight = self.robust.weight(plain).sqrt()
        tests, x = self.tests.rows(part), self.values[part]
        forcing = self.motion.rows(theta, x)  # (B, K + 1, L, P) of the last L components
        still, moved = x.shape[-1] - forcing.shape[2], forcing.shape[2]
        sums = integrated(tests.on_field, tests.stride, forcing.flatten(2)).unflatten(-1, forcing.shape[2:])
        sums.mul_(
            (tests.there.unsqueeze(-1) / self.batch.instrument.deviations[-moved:]).unsqueeze(-1).to(sums)
        )
        padded = torch.nn.functional.pad(sums, (0, 0, still, 0)) if still else sums
        jacobian = self.factor.rows(part).whiten(padded)
        jacobian = jacobian.mul_(weight.unsqueeze(-1).to(jacobian)).flatten(0, 2)
        # The result depends on sums of many residuals, whose matrix loses all digits in float32.
        return ResidualRows(self.robust.cost(plain).sum(), (weight * plain).flatten(), jacobian.to(theta))
