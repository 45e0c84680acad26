"""Maximum-likelihood noise parameters from filter innovations, without known truth.

The log-likelihood of the innovations equals the log-likelihood of the measurements, given the noise
parameters (Schweppe 1965), and the filter is differentiable. The parameters are unconstrained numbers, such
as logarithms of standard deviations or of a time constant; a quasi-Newton method maximises the likelihood
from an initial guess.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.estimation.results import FilterResult

LOST = 1e12
"""Negative log-likelihood assigned to a filter that loses a member."""


class Learned(NamedTuple):
    """Result of `learned_noise`.

    Attributes:
        parameters: (P,) maximiser of the log-likelihood.
        deviations: (P,) standard deviations, from the curvature at the maximum; all NaN if there is no
            maximum, since the measurements do not determine a parameter.
        log_likelihood: sum over all members.
    """

    parameters: Tensor
    deviations: Tensor
    log_likelihood: float


def learned_noise(
    filtered: Callable[[Tensor], FilterResult], guess: Tensor, *, iterations: int = 30, step: float = 1e-3
) -> Learned:
    """Estimate the noise parameters that maximise the likelihood.

    Args:
        filtered: function that runs a filter with `gradients=True` and noise parameters (P,).
        guess: (P,) initial parameters of order one, such as logarithms.
        iterations: maximum number of iterations.
        step: step of the central differences of the gradient, which give the deviations.

    Raises:
        UserError: the guess makes a filter member fail, or has no gradient.
    """

    def loss(parameters: Tensor) -> Tensor:
        result = filtered(parameters)
        # A trial that loses a member has a large but finite cost, so that the line search backtracks.
        lost = bool((result.status != 0).any())
        return 0.0 * parameters.sum() + LOST if lost else -result.log_likelihood.sum()

    current = guess.detach().to(torch.float64).clone().requires_grad_()
    first = loss(current)
    if not float(first.detach()) < LOST or not first.requires_grad:
        what = "no gradient" if not first.requires_grad else "lost members"
        message = (
            "learned_noise: expected a filter that follows all members, with gradients, at the initial "
            "guess; received "
            f"{what}; begin with more noise, and pass gradients=True"
        )
        raise UserError(message)
    optimizer = torch.optim.LBFGS(
        [current], max_iter=iterations, tolerance_grad=1e-5, line_search_fn="strong_wolfe"
    )

    def closure() -> float:
        optimizer.zero_grad()
        value = loss(current) / first.detach().abs()
        value.backward()
        return float(value.detach())

    optimizer.step(closure)
    best = current.detach()
    return Learned(best, _deviations(loss, best, step), -float(loss(best).detach()))


def _deviations(loss: Callable[[Tensor], Tensor], best: Tensor, step: float) -> Tensor:
    """Return square roots of the inverse Hessian's diagonal, (P,), by central differences of gradients."""

    def gradient(parameters: Tensor) -> Tensor:
        parameters = parameters.requires_grad_()
        return torch.autograd.grad(loss(parameters), parameters)[0]

    rows = [gradient(best + d) - gradient(best - d) for d in step * torch.eye(len(best), dtype=best.dtype)]
    hessian = torch.stack(rows) / (2 * step)
    chol, info = torch.linalg.cholesky_ex((hessian + hessian.mT) / 2)
    if int(info) != 0:
        return torch.full_like(best, torch.nan)
    return torch.cholesky_inverse(chol).diagonal().sqrt()
