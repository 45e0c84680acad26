"""Gradients through the filter: against differences, and noise learned from innovations."""

from __future__ import annotations

import math

import pytest
import torch

from ahnn.estimation import initial_belief
from ahnn.measurements import Position
from ahnn_plugins.ukf import (
    SQUARE_ROOT,
    STANDARD,
    UnscentedKalmanFilter,
    UnscentedParameters,
    unscented_filter,
)

F64 = torch.float64
STEP = 0.3


def oscillator(x, dt):
    c, s = math.cos(dt), math.sin(dt)
    return x @ torch.tensor([[c, -s], [s, c]], dtype=F64)


def likelihood(theta, form, parameters):
    """Negative log-likelihood as a function of a frequency, log sds of Q and R, and the initial mean."""
    ukf = UnscentedKalmanFilter(parameters, form)
    state = ukf.start(initial_belief(theta[3:].expand(2, 2), 0.5 * torch.eye(2)))

    def pendulum(x, dt):
        p = x[:, 1] - dt * theta[0] * torch.sin(x[:, 0])
        return torch.stack((x[:, 0] + dt * p, p), dim=-1)

    q = torch.diag(torch.stack((torch.full((), 1e-3, dtype=F64), theta[1].exp())))
    rows = torch.tensor([[[0.3], [0.4], [torch.nan], [0.1]], [[0.5], [0.2], [0.1], [0.0]]], dtype=F64)
    for k in range(4):
        state = ukf.predict(state, pendulum, STEP, q)
        state, _ = ukf.update(state, rows[:, k], Position(1), theta[2].exp().reshape(1, 1))
    return -state.log_likelihood.sum()


@pytest.mark.parametrize("form", [SQUARE_ROOT, STANDARD], ids=lambda form: form.name)
@pytest.mark.parametrize("parameters", [(1.0, 2.0, 0.0), (0.5, 2.0, 1.0), (1.0, 0.0, -0.5)])
def test_gradient_of_the_likelihood_equals_central_differences(form, parameters):
    point = torch.tensor([1.2, -3.0, -2.0, 0.2, -0.1], dtype=F64)
    theta = point.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(likelihood(theta, form, UnscentedParameters(*parameters)), theta)
    h = 1e-3
    for i, direction in enumerate(torch.eye(5, dtype=F64)):
        # The fourth-order difference leaves h^4, 1e-12, beside the rounding.
        values = [
            float(likelihood(point + n * h * direction, form, UnscentedParameters(*parameters)))
            for n in (-2, -1, 1, 2)
        ]
        numeric = (values[0] - 8.0 * values[1] + 8.0 * values[2] - values[3]) / (12.0 * h)
        assert float(gradient[i]) == pytest.approx(numeric, rel=1e-6)


def test_q_and_r_are_learned_from_the_innovations():
    generator = torch.Generator().manual_seed(0)
    true_q, true_r, x, rows = 0.05, 0.3, torch.zeros(200, 2, dtype=F64), []
    for _ in range(60):
        x = oscillator(x, STEP) + true_q * torch.randn(200, 2, generator=generator, dtype=F64)
        rows.append(x[:, :1] + true_r * torch.randn(200, 1, generator=generator, dtype=F64))
    y, eye = torch.stack(rows, 1), torch.eye(2, dtype=F64)
    belief = initial_belief(torch.zeros(200, 2), 1e-4 * eye)

    log_sd = torch.zeros(2, dtype=F64, requires_grad=True)  # of Q and R, both begun at 1
    optimizer = torch.optim.LBFGS([log_sd], max_iter=15, line_search_fn="strong_wolfe")

    def loss():
        optimizer.zero_grad()
        q, r = log_sd.exp() ** 2
        result = unscented_filter(
            oscillator, belief, y, Position(1), q * eye, r.reshape(1, 1), STEP, gradients=True
        )
        (value := -result.log_likelihood.mean()).backward()
        return value

    optimizer.step(loss)
    # 12,000 numbers know a standard deviation to 1/sqrt(24,000) at best.
    q, r = log_sd.detach().exp().tolist()
    assert q == pytest.approx(true_q, rel=0.05)
    assert r == pytest.approx(true_r, rel=0.02)


def test_the_batch_loop_keeps_a_graph_only_when_asked_to():
    scale = torch.ones(1, dtype=F64, requires_grad=True)
    belief = initial_belief([[0.1, 0.0]], torch.eye(2))
    arguments = (belief, torch.zeros(1, 3, 1), Position(1), 0.1 * torch.eye(2), torch.eye(1), STEP)

    def run(**options):
        return unscented_filter(lambda x, dt: scale * oscillator(x, dt), *arguments, **options)

    assert not run().log_likelihood.requires_grad
    kept = run(gradients=True, smoothing=True)
    assert kept.log_likelihood.requires_grad
    # With a graph it is torch's linear algebra, without one the library's.
    torch.testing.assert_close(kept.means.detach(), run().means, rtol=1e-13, atol=1e-15)
