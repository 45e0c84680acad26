"""Maximum a posteriori steps on all measurements, with a prior on the parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics, HasField
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.measurements import Segment
from ahnn.measurements.smoothing import guess
from ahnn.progress import note
from ahnn.shooting.initial_states import LOST, Fitted, Trial, follow_starts, followed, regained
from ahnn.shooting.path_sensitivities import Steps
from ahnn.shooting.quadrature import coarse
from ahnn.shooting.robust import Robust
from ahnn.training.closing_journal import is_active, kept
from ahnn.training.evidence import Prior, determined, posterior_factor
from ahnn.training.limited_segments import Limit, freedom
from ahnn.training.normal_equations import Block, Equations
from ahnn.training.shared_bias import SharedBias, columns_of, eliminated, of_biases, pull_of
from ahnn.training.shooting import ShootingProblem


class WideProblem(ShootingProblem):
    """Shooting problem with float64 normal equations, which preserve poorly determined directions.

    Unknown sensor biases are eliminated from them; `shared` contains the biases after `equations`.
    """

    precision = torch.float64
    shared: SharedBias | None = None

    @torch.no_grad()
    def equations(self, theta: Tensor, sizes: Sequence[int]) -> Equations:
        """Return loss and normal equations, with initial states and biases eliminated."""
        if not len(self.starts):
            return super().equations(theta, sizes)

        def compute() -> dict[str, Tensor]:
            found = super(WideProblem, self).equations(theta, sizes)
            return {
                "loss": found.loss,
                "matrix": found.blocks[0].matrix,
                "gradient": found.blocks[0].gradient,
            }

        found = kept("normal equations", compute)
        block = Block(torch.arange(len(found["gradient"])), found["matrix"], found["gradient"])
        found = Equations(found["loss"], self.count, [block])
        if self.batch.instrument.bias_sd is None:
            return found
        found, self.shared = eliminated(found, self.batch.instrument)
        return found

    def with_more(self, of_theta: Tensor, here: Fitted, part: slice) -> Tensor:
        """Append columns of unknown biases to derivatives of residuals (B, K + 1, M, P)."""
        segment = self.batch.rows(part)
        if segment.instrument.bias_sd is None:
            return of_theta
        weight = self.robust.weight(segment.white_residuals(here.states[:, self.steps.ends])).sqrt()
        columns = columns_of(of_biases(segment) * weight, segment.instrument)
        return torch.cat((of_theta, columns.to(of_theta)), dim=-1)

    @property
    def cost(self) -> Tensor:
        """The sum of squared residuals at the parameters of the dynamics, for the best biases."""
        return self._with_best_biases(super().cost, self.fitted.rows(self.kept))

    @torch.no_grad()
    def loss(self, theta: Tensor) -> Tensor:
        """Return the sum of squared residuals for the best initial states and biases."""

        def compute() -> dict[str, Tensor]:
            plain = super(WideProblem, self).loss(theta)
            some = len(self.starts) > 0
            return {"loss": self._with_best_biases(plain, self.refitted(theta)) if some else plain}

        return kept("trial of a step", compute)["loss"]

    @torch.no_grad()
    def gradient(self, theta: Tensor) -> Tensor:
        """Return J^T r, shape (P,), like `ShootingProblem.gradient`."""
        return kept("gradient", lambda: {"gradient": super(WideProblem, self).gradient(theta)})["gradient"]

    def fit(
        self, trial: Trial, starts: Tensor | None, batch: Segment, steps: Steps, hopeless: float
    ) -> Fitted:
        """Fit the initial states; with a journal, paths are recomputed from them and are bit-identical."""

        def fitted() -> Fitted:
            found = super(WideProblem, self).fit(trial, starts, batch, steps, hopeless)
            explained = bool((found.sums <= LOST * batch.measured).any())
            if starts is not None or not explained:  # if no segment fits, no path was lost
                return found
            return regained(trial, found, guess(batch), batch, steps, hopeless)

        return self._paths(trial, fitted, batch, steps)

    def _paths(self, trial: Trial, fit: Callable[[], Fitted], batch: Segment, steps: Steps) -> Fitted:
        if not is_active():
            note("initial states")
            return fit()

        def compute() -> dict[str, Tensor]:
            found = fit()
            return {"starts": found.starts, "lost": found.sums.isinf()}

        found = kept("initial states", compute)
        states, sums = followed(trial, found["starts"], batch, steps)
        return Fitted(states, sums.masked_fill(found["lost"], torch.inf))

    def _with_best_biases(self, loss: Tensor, fitted: Fitted) -> Tensor:
        return loss if self.shared is None else loss - self.shared.gain(self.pull(fitted))

    def pull(self, fitted: Fitted) -> Tensor:
        """Return the gradient (K,) with respect to the biases, for fitted initial states."""
        rows = self.batch.white_residuals(fitted.states[:, self.steps.ends])
        weight = self.robust.weight(rows) * self.limit.weight(fitted.sums)[:, None, None]
        return pull_of(rows * weight, self.batch)

    def reduced(self, gradient: Tensor) -> Tensor:
        """Return the gradient (P,) in the parameters of the dynamics, with biases eliminated."""
        if self.shared is None:
            return gradient
        return self.shared.gradient(gradient, self.pull(self.fitted.rows(self.kept)))

    @torch.no_grad()
    def follow(self, theta: Tensor) -> None:
        """Refit the initial states after a step to theta, shape (P,)."""
        trial, near = self.trial(theta), lambda: self.refitted(theta).starts
        fit = lambda: follow_starts(trial, near(), self.batch, self.steps)  # noqa: E731
        fitted, self._linear = self._paths(trial, fit, self.batch, self.steps), None
        self.fitted, self.starts, self.limit = (
            fitted,
            fitted.starts,
            Limit.of(fitted.sums, freedom(self.batch)),
        )


def whole_problem(dynamics: Dynamics, batch: Segment, robust: Robust) -> WideProblem:
    """Build the problem of all segments, with quartered integrator steps if J is otherwise too inaccurate."""
    problem = WideProblem(dynamics, batch, robust)
    states = problem.fitted.states[problem.kept]
    if not coarse(cast(HasField, dynamics).field, states, problem.steps.lengths):
        return problem
    return WideProblem(dynamics, batch, robust, starts=problem.fitted.starts, quartered=True)


def after(problem: WideProblem, dynamics: Dynamics) -> WideProblem:
    """Build the problem of the same segments for similar dynamics."""
    quartered = problem.steps.quartered
    found = WideProblem(dynamics, problem.batch, problem.robust, starts=problem.starts, quartered=quartered)
    found.shared = problem.shared
    return found


@torch.no_grad()
def of_functions(problem: WideProblem, dynamics: Dynamics, weights: Tensor, places: Tensor) -> Block:
    """Return the normal equations in the P parameters in which the functions are linear.

    Args:
        problem: problem of the functions.
        dynamics: dynamics about which they are linearised.
        weights: parameters of the functions.
        places: indices of the P parameters among these (`ahnn.dynamics.linearised`).
    """
    own, rows = problem.forcing, field_jacobian(cast(HasField, dynamics), problem.precision)
    problem.forcing = lambda _, states: rows(weights[places], states)
    _, _, (block,) = problem.equations(weights, [])
    problem.forcing = own
    return block


def with_prior(block: Block, prior: Prior, theta: Tensor) -> Block:
    """Return the normal equations of residuals and prior at theta, shape (P,)."""
    precision = prior.precision
    matrix = block.matrix + torch.diag(precision)
    return block._replace(matrix=matrix, gradient=block.gradient + precision * theta)


class PosteriorPoint(NamedTuple):
    """Quadratic model of residuals and prior about given parameters.

    Attributes:
        theta: (P,) parameters.
        loss, degrees, block: quantities of the residuals, as in `Equations`.
        prior: prior of maximum evidence at the beginning of function-space steps.
        factor: L, (P, P); L L^T is the inverse of the matrix of residuals and prior.
        determined: number of parameters that the data determine.
        pull: (P,) gradient of half the objective with respect to u, for theta = ... + L u.
    """

    theta: Tensor
    loss: Tensor
    degrees: int
    block: Block
    prior: Prior
    factor: Tensor
    determined: float
    pull: Tensor

    @classmethod
    def of(cls, theta: Tensor, loss: Tensor, degrees: int, block: Block, prior: Prior) -> PosteriorPoint:
        """Build the point with its factor and gradient."""
        factor = posterior_factor(block.matrix, prior)
        pull = factor.mT @ (block.gradient + prior.precision * theta)
        return cls(theta, loss, degrees, block, prior, factor, float(determined(factor, prior).sum()), pull)

    @property
    def offset(self) -> Tensor:
        """Step (P,) to the optimum."""
        return -self.factor @ self.pull

    @property
    def remaining(self) -> float:
        """Squared length of that step in standard deviations, equal to its predicted decrease."""
        return float(self.pull @ self.pull)

    @property
    def chi_square(self) -> float:
        """Squared residuals per degree of freedom."""
        return float(self.loss) / max(self.degrees - self.determined, 1.0)

    @property
    def objective(self) -> float:
        """Sum of squared residuals and prior contribution."""
        return float(self.loss + self.prior.penalty(self.theta))

    def moved(self, theta: Tensor, loss: Tensor, gradient: Tensor) -> PosteriorPoint:
        """Return another point with the same matrix, from its J^T r, shape (P,)."""
        pull = self.factor.mT @ (gradient + self.prior.precision * theta)
        return self._replace(theta=theta, loss=loss, pull=pull, block=self.block._replace(gradient=gradient))

    def left(self, promised: float) -> PosteriorPoint:
        """Return the point with its remaining step limited to a predicted decrease."""
        part = min(max(promised / self.remaining, 0.0), 1.0) if self.remaining > 0 else 0.0
        return self._replace(pull=part**0.5 * self.pull)
