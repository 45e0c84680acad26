"""Noise learned by innovation likelihood: that of a Kalman filter, and the law that was simulated."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from ahnn.errors import UserError
from ahnn.estimation import initial_belief
from ahnn.estimation.force_error import ForceError
from ahnn.estimation.likelihood import _deviations, learned_noise
from ahnn.measurements import Position
from ahnn_plugins.ukf import SQUARE_ROOT, STANDARD, unscented_filter

F64 = torch.float64
A = torch.tensor([[1.0, 0.3], [-0.3, 0.9]], dtype=F64)
Q, R, P0 = 0.05, 0.3, 0.5
MEMBERS, STEPS = 60, 30


def flow(x, dt):  # noqa: ARG001
    return x @ A.mT


@pytest.fixture(scope="module")
def rows():
    rng = np.random.default_rng(0)
    x, out = P0 * rng.normal(size=(MEMBERS, 2)), []
    for _ in range(STEPS):
        x = x @ A.numpy().T + Q * rng.normal(size=(MEMBERS, 2))
        out.append(x[:, :1] + R * rng.normal(size=(MEMBERS, 1)))
    return torch.from_numpy(np.stack(out, 1))


def filtered(rows):
    belief, eye = initial_belief(torch.zeros(len(rows), 2), P0**2 * torch.eye(2)), torch.eye(2, dtype=F64)

    def run(log_sd):
        q, r = log_sd.exp() ** 2
        return unscented_filter(
            flow, belief, rows, Position(1), q * eye, r.reshape(1, 1), 1.0, gradients=True
        )

    return run


def kalman_likelihood(rows, q, r):
    """Log-likelihood of a textbook Kalman filter, in NumPy."""
    a, h, total = A.numpy(), np.array([[1.0, 0.0]]), 0.0
    for member in rows.numpy():
        mean, cov = np.zeros(2), P0**2 * np.eye(2)
        for y in member:
            mean, cov = a @ mean, a @ cov @ a.T + q**2 * np.eye(2)
            s = (h @ cov @ h.T).item() + r**2
            e = (y - h @ mean).item()
            total -= 0.5 * (math.log(2 * math.pi * s) + e**2 / s)
            gain = (cov @ h.T / s)[:, 0]
            mean, cov = mean + gain * e, cov - s * np.outer(gain, gain)
    return total


def test_the_likelihood_is_that_of_a_kalman_filter_and_largest_at_what_is_learned(rows):
    found = learned_noise(filtered(rows), torch.tensor([-1.0, -0.5]))
    q, r = found.parameters.exp().tolist()
    best = kalman_likelihood(rows, q, r)
    assert found.log_likelihood == pytest.approx(best, rel=1e-10)
    for factor in (0.98, 1.02):
        assert kalman_likelihood(rows, factor * q, r) < best
        assert kalman_likelihood(rows, q, factor * r) < best


def test_what_was_simulated_is_found_within_the_deviations(rows):
    found = learned_noise(filtered(rows), torch.tensor([0.0, 0.0]))
    off = (found.parameters - torch.tensor([Q, R], dtype=F64).log()) / found.deviations
    assert float(off.abs().max()) < 3.0
    # R alone, known to 1,800 numbers, would have 1 / sqrt(3,600).
    assert 1.0 < float(found.deviations[1]) * 60 < 1.5
    assert float(found.deviations[0]) < 0.2


def test_size_and_memory_of_a_force_error_are_learned_from_measurements():
    def falling(x, dt):
        q, p = x.chunk(2, dim=-1)
        return torch.cat((q + dt * p, p + 1.0 * dt), dim=-1)

    size, memory, members = 0.5, 2.0, 120
    kept = math.exp(-0.5 / memory)
    rng = np.random.default_rng(1)
    x, e, out = np.zeros((members, 2)), size * rng.normal(size=members), []
    for _ in range(30):
        q, p = x.T
        x = np.stack((q + 0.5 * p + 0.25 * 0.5 * e, p + 0.5 + 0.5 * e), 1)
        e = kept * e + size * math.sqrt(1 - kept**2) * rng.normal(size=members)
        out.append(x[:, :1] + 0.02 * rng.normal(size=(members, 1)))
    rows, zero = torch.from_numpy(np.stack(out, 1)), torch.zeros(2, 2, dtype=F64)
    belief = initial_belief(torch.zeros(members, 2), 1e-6 * torch.eye(2))

    def run(theta):
        error = ForceError(*theta.exp())
        law = error.flow(falling), error.belief(belief), rows, error.measurement(Position(1))
        noise = error.process_noise(zero, 0.5), 0.02**2 * torch.eye(1)
        return unscented_filter(*law, *noise, 0.5, gradients=True)

    found = learned_noise(run, torch.zeros(2))
    off = (found.parameters - torch.tensor([size, memory], dtype=F64).log()) / found.deviations
    assert float(off.abs().max()) < 3.0
    assert float(found.deviations.max()) < 0.1


def test_a_guess_that_loses_members_is_refused(rows):
    with pytest.raises(UserError, match="begin with more noise"):
        learned_noise(filtered(rows), torch.tensor([-1e3, -1e3]))
    with pytest.raises(UserError, match="received no gradient"):
        learned_noise(lambda theta: filtered(rows)(theta.detach()), torch.zeros(2))


def test_what_the_measurements_do_not_determine_has_no_deviation(rows):
    run = filtered(rows[:, :10])
    found = learned_noise(lambda theta: run(theta[:2] + 0.0 * theta[2]), torch.zeros(3))
    assert bool(found.deviations.isnan().all())


@pytest.mark.parametrize("gradients", [False, True])
@pytest.mark.parametrize("form", [SQUARE_ROOT, STANDARD], ids=lambda form: form.name)
def test_rows_that_are_missing_say_nothing_of_the_likelihood(rows, gradients, form):
    some = rows[:4, :20].clone()
    some[:2, 1::2], some[2:, ::3] = torch.nan, torch.nan  # never all of the members at once
    belief, eye = initial_belief(torch.zeros(4, 2), P0**2 * torch.eye(2)), torch.eye(2, dtype=F64)
    noise = Q**2 * eye, R**2 * eye[:1, :1]
    arguments = (flow, belief, some, Position(1), *noise, 1.0)
    found = unscented_filter(*arguments, form=form, gradients=gradients).log_likelihood
    for b in range(4):
        mean, cov, total = np.zeros(2), P0**2 * np.eye(2), 0.0
        for y in some[b, :, 0].tolist():
            mean, cov = A.numpy() @ mean, A.numpy() @ cov @ A.numpy().T + Q**2 * np.eye(2)
            if math.isnan(y):
                continue
            s, e = cov[0, 0] + R**2, y - mean[0]
            total -= 0.5 * (math.log(2 * math.pi * s) + e**2 / s)
            gain = cov[:, 0] / s
            mean, cov = mean + gain * e, cov - s * np.outer(gain, gain)
        assert float(found[b]) == pytest.approx(total, rel=1e-10)


def test_deviations_are_the_roots_of_the_diagonal_of_the_inverse_hessian():
    root = torch.tensor([[2.0, 0.5, 0.1], [0.0, 1.0, -0.7], [0.0, 0.0, 3.0]], dtype=F64)
    best = torch.tensor([1.0, -2.0, 0.3], dtype=F64)
    found = _deviations(lambda x: 0.5 * (root @ (x - best)).square().sum(), best, 1e-3)
    expected = torch.linalg.inv(root.mT @ root).diagonal().sqrt()
    assert found.tolist() == pytest.approx(expected.tolist(), rel=1e-9)
