"""A relative force error with memory: its law, a filter that is consistent with it, and its fit."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.stats import chi2

from ahnn.estimation import Setting, initial_belief, simulated
from ahnn.estimation.consistency import nees
from ahnn.estimation.force_error import ForceError
from ahnn.estimation.force_error_fit import fitted_force_error, force_errors, memory_of
from ahnn.estimation.scenario import Problem
from ahnn.estimation.trial import Filter, assimilate, assimilate_all
from ahnn.measurements import Position, State
from ahnn.types import Trajectories
from ahnn_plugins.ukf import UnscentedKalmanFilter, unscented_filter

F64 = torch.float64
DT, MASS = 0.05, 2.0
ZERO = torch.zeros(2, 2, dtype=F64)


def spring(x, dt):
    """Leapfrog for H = p^2 / 2 m + q^2 / 2; dt is a number."""
    q, p = x.chunk(2, dim=-1)
    p = p - dt / 2 * q
    q = q + dt / MASS * p
    return torch.cat((q, p - dt / 2 * q), dim=-1)


def falling(x, dt):
    """A constant force of 3 N, which acts along the momentum."""
    q, p = x.chunk(2, dim=-1)
    dt = dt[:, None] if isinstance(dt, torch.Tensor) else dt
    return torch.cat((q + dt / MASS * p + 3.0 * dt**2 / (2 * MASS), p + 3.0 * dt), dim=-1)


def erring(size, memory, count, steps, seed):
    """Springs whose force is off by a Gauss-Markov fraction, (B, T + 1, 2), and the fractions (B, T)."""
    rng = np.random.default_rng(seed)
    kept = math.exp(-DT / memory)
    error = size * rng.normal(size=count)
    x = rng.normal(size=(count, 2))
    states, errors = [x], []
    for _ in range(steps):
        after = spring(torch.from_numpy(x), DT).numpy()
        kick = error * np.abs(after[:, 1] - x[:, 1])
        x = after + np.stack((DT / (2 * MASS) * kick, kick), axis=1)
        errors.append(error)
        error = kept * error + size * math.sqrt(1 - kept**2) * rng.normal(size=count)
        states.append(x)
    return torch.from_numpy(np.stack(states, 1)), torch.from_numpy(np.stack(errors, 1))


def test_a_constant_relative_error_of_a_constant_force_is_another_force():
    flow = ForceError(0.1, 1e12, MASS).flow(falling)
    x = torch.tensor([[0.5, -1.0, 0.2]], dtype=F64)
    for _ in range(10):
        x = flow(x, DT)
    time, force = 10 * DT, 3.0 * 1.2
    expected = [0.5 - time / MASS + force * time**2 / (2 * MASS), -1.0 + force * time, 0.2]
    assert x[0].tolist() == pytest.approx(expected, rel=1e-10)


def test_steps_of_each_member_and_of_all_agree():
    flow = ForceError(0.1, 0.4, MASS).flow(falling)
    x = torch.randn(3, 3, generator=torch.Generator().manual_seed(0), dtype=F64)
    assert torch.equal(flow(x, torch.full((3,), DT, dtype=F64)), flow(x, DT))


def test_the_error_keeps_its_law():
    error = ForceError(torch.tensor([0.3, 0.01], dtype=F64), 0.7, MASS)
    q = error.process_noise(ZERO, DT)
    kept = math.exp(-DT / 0.7)
    for member, size in enumerate((0.3, 0.01)):
        assert float(q[member, 2, 2]) == pytest.approx(size**2 * (1 - kept**2), rel=1e-12)
    belief = error.belief(initial_belief(torch.zeros(2, 2), torch.eye(2)))
    nothing, measurement = torch.full((2, 50, 1), torch.nan), error.measurement(Position(1))
    still = unscented_filter(error.flow(falling), belief, nothing, measurement, q, torch.eye(1), DT)
    assert float(q[:, :2].abs().sum()) == 0.0
    variance = still.covariances[:, :, 2, 2]
    assert torch.allclose(variance, torch.tensor([[0.09], [1e-4]], dtype=F64).expand(2, 50), rtol=1e-9)


def problem(size, memory, count, steps, seed):
    truth, errors = erring(size, memory, count, steps, seed)
    sd = torch.full((2,), 0.01, dtype=F64)
    setting = Setting(Position(1), sd[:1], sd, tuple(range(1, steps + 1)))
    noise = 0.01 * torch.randn(count, 2, generator=torch.Generator().manual_seed(seed), dtype=F64)
    measured = simulated(setting, truth, DT, seed)
    return setting, Problem(truth, truth[:, 0] + noise, measured, DT), errors


@pytest.mark.parametrize("count", [2, 5, 7])
def test_a_measurement_sees_the_state_alone(count):
    x = torch.randn(3, count, 9, dtype=F64)
    error = ForceError(spring, 1e-3, 1.0)
    assert torch.equal(error.measurement(State(3))(x, 0.0), x[..., :6])


def test_a_filter_that_knows_the_error_is_consistent_and_one_that_does_not_is_not():
    setting, arcs, _ = problem(0.3, 0.5, count=400, steps=80, seed=1)
    plain = Filter("spring", spring, ZERO, setting.measurement_noise, UnscentedKalmanFilter())
    knowing = plain._replace(force_error=ForceError(0.3, 0.5, MASS))
    filtered, behind = assimilate_all(knowing, setting, arcs, ["smoothed", "iterated"])
    low, high = (chi2.ppf(p, 800) / 400 for p in (1e-4, 1 - 1e-4))
    for result in (filtered, *(found.beliefs for found in behind.smoothed.values())):
        assert result.means.shape == (400, 80, 2)
        values = nees(result.means - arcs.truth[:, 1:], result.chols)
        for k in (10, 40, 79):
            assert low < float(values[:, k].mean()) < high
    assert torch.equal(assimilate(knowing, setting, arcs).means, filtered.means)
    ignorant = assimilate(plain, setting, arcs)
    assert float(nees(ignorant.means - arcs.truth[:, 1:], ignorant.chols)[:, 40:].mean()) > 2 * high


def test_size_and_memory_are_found_in_the_residuals():
    truth, errors = erring(1e-3, 0.5, count=200, steps=400, seed=2)
    times = DT * torch.arange(401, dtype=F64).expand(200, -1)
    seen = force_errors(spring, Trajectories(truth, times), DT)
    # The impulse of the model, without the error, is that of the law.
    assert torch.allclose(seen[..., 0], errors, rtol=1e-6, atol=1e-9)
    assert float(seen.square().mean().sqrt()) == pytest.approx(1e-3, rel=0.03)
    assert memory_of(seen, DT) == pytest.approx(0.5, rel=0.1)
    assert memory_of(torch.randn(200, 400, 1, dtype=F64), DT) < DT


def test_the_fit_finds_the_law_and_takes_what_is_given():
    setting, arcs, _ = problem(0.3, 0.5, count=100, steps=80, seed=3)
    times = DT * torch.arange(81, dtype=F64).expand(100, -1)
    data = Trajectories(arcs.truth, times)
    plain = Filter("spring", spring, ZERO, setting.measurement_noise, UnscentedKalmanFilter())
    fit = fitted_force_error(plain, setting, arcs, data, MASS)
    assert fit.scale == pytest.approx(1.0, rel=0.4)
    assert float(fit.error.size) == pytest.approx(0.3, rel=0.2)
    assert float(fit.error.memory) == pytest.approx(0.5, rel=0.3)
    given = fitted_force_error(plain, setting, arcs, data, MASS, size=0.1, memory=3.0)
    assert given == (ForceError(0.1, 3.0, MASS), 1.0, ())


def test_a_flow_without_residuals_has_no_force_error():
    x = torch.randn(3, 1, 2, generator=torch.Generator().manual_seed(0), dtype=F64)
    states = [x[:, 0]]
    for _ in range(20):
        states.append(spring(states[-1], DT))
    data = Trajectories(torch.stack(states, 1), DT * torch.arange(21, dtype=F64).expand(3, -1))
    setting, arcs, _ = problem(0.3, 1.0, count=3, steps=20, seed=0)
    plain = Filter("spring", spring, ZERO, setting.measurement_noise, UnscentedKalmanFilter())
    fit = fitted_force_error(plain, setting, arcs, data, MASS)
    assert (fit.error.size, fit.scale, fit.nees) == (0.0, 1.0, ())
