"""The extended Kalman filter: exact on lines, that of filterpy on curves, consistent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from filterpy.kalman import ExtendedKalmanFilter as Reference
from scipy.stats import chi2

from ahnn.dynamics import make_dynamics
from ahnn.dynamics.recorded_flow import recorded
from ahnn.dynamics.transition import transition
from ahnn.estimation import Gate, Setting, Status, initial_belief, nees, perturbed_arcs
from ahnn.estimation.force_error import ForceError
from ahnn.estimation.parameter_error import ParameterError
from ahnn.estimation.smoother import smoother
from ahnn.estimation.trial import Filter, assimilate
from ahnn.evaluation.open_loop import Integrated
from ahnn.integrators import INTEGRATORS
from ahnn.jacobians import pointwise_jacobian
from ahnn.measurements import GroundStation, Position, State
from ahnn.systems import MassSpring, Molniya, exact_flow
from ahnn_plugins.ekf import ExtendedKalmanFilter

F64, NAN = torch.float64, float("nan")
A = torch.tensor([[1.0, 0.1, 0.0], [-0.2, 0.97, 0.05], [0.0, 0.1, 0.9]], dtype=F64)
H = torch.tensor([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0]], dtype=F64)


class Linear:
    names, units = ("a", "b"), ("1", "1")

    def __call__(self, x, t):
        return x @ H.mT


class Range:
    names, units = ("range",), ("m",)

    def __call__(self, x, t):
        return (1.0 + x[..., :1].square()).sqrt()


def swing(x, dt):
    p = x[:, 1:] - dt * torch.sin(x[:, :1])
    return torch.cat((x[:, :1] + dt * p, p), dim=1)


def draw(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


def kalman(mean, p, rows, q, r):
    """The textbook Kalman filter and Rauch-Tung-Striebel smoother of one member, NaN rows left out."""
    kept = []
    for row in rows:
        mean, p = A @ mean, A @ p @ A.mT + q
        before = mean, p
        there = ~row.isnan()
        if bool(there.any()):
            h = H[there]
            gain = p @ h.mT @ torch.linalg.inv(h @ p @ h.mT + r[there][:, there])
            mean, p = mean + gain @ (row[there] - h @ mean), (torch.eye(3, dtype=F64) - gain @ h) @ p
        kept.append((before, (mean, p)))
    smoothed = [kept[-1][1]]
    for k in range(len(kept) - 2, -1, -1):
        (ahead, p_ahead), (m, c) = kept[k + 1][0], kept[k][1]
        gain = c @ A.mT @ torch.linalg.inv(p_ahead)
        m_after, c_after = smoothed[-1]
        smoothed.append((m + gain @ (m_after - ahead), c + gain @ (c_after - p_ahead) @ gain.mT))
    return [state for _, state in kept], smoothed[::-1]


@pytest.mark.parametrize("smoothing", [False, True])
def test_on_a_linear_system_it_is_the_kalman_filter_and_its_smoother(smoothing):
    q, r = 1e-2 * torch.eye(3, dtype=F64), torch.tensor([[0.1, 0.02], [0.02, 0.2]], dtype=F64)
    rows, p0 = draw(2, 30, 2), torch.diag(torch.tensor([1.0, 2.0, 0.5], dtype=F64))
    rows[0, 4, 0], rows[1, 7] = NAN, NAN
    belief = initial_belief(draw(2, 3, seed=1), p0)
    result = ExtendedKalmanFilter().run(
        lambda x, _: x @ A.mT, belief, rows, Linear(), q, r, 0.1, smoothing=smoothing
    )
    found = [(result.means, result.covariances)]
    found += [(s.means, s.covariances) for s in [smoother(result)]] if smoothing else []
    for b in range(2):
        references = kalman(belief.mean[b], p0, rows[b], q, r)
        for (means, covariances), expected in zip(found, references, strict=False):
            for ours, theirs in zip((means[b], covariances[b]), zip(*expected, strict=True), strict=True):
                torch.testing.assert_close(ours, torch.stack(theirs), rtol=1e-10, atol=1e-12)


def test_on_a_pendulum_it_is_the_filter_of_filterpy():
    rows = 1.0 + 0.1 * draw(1, 60, 1)
    q, dt = np.diag([1e-6, 1e-4]), 0.1
    result = ExtendedKalmanFilter().run(
        swing, initial_belief([[0.8, 0.1]], 0.1 * np.eye(2)), rows, Range(), q, [[0.01]], dt
    )

    class Pendulum(Reference):
        def predict_x(self, u=0):
            q, p = self.x
            p = p - dt * np.sin(q)
            self.x = np.array([q + dt * p, p])

    theirs = Pendulum(2, 1)
    theirs.x, theirs.P, theirs.Q, theirs.R = np.array([0.8, 0.1]), 0.1 * np.eye(2), q, np.array([[0.01]])
    for k, row in enumerate(rows[0].numpy()):
        kick = -dt * np.cos(theirs.x[0])
        theirs.F = np.array([[1 + dt * kick, dt], [kick, 1.0]])
        theirs.predict()
        theirs.update(
            row,
            lambda x: np.array([[x[0] / np.sqrt(1 + x[0] ** 2), 0.0]]),
            lambda x: np.array([np.sqrt(1 + x[0] ** 2)]),
        )
        np.testing.assert_allclose(result.means[0, k], theirs.x, rtol=1e-9)
        np.testing.assert_allclose(result.covariances[0, k], theirs.P, rtol=1e-9)


SPRING = MassSpring(name="spring", dt=0.05, steps=80)
ORBITS = Molniya(name="orbits", dt=60.0, steps=60)


def accurate(system):
    """The flow of a spring without iterations, in one explicit step of order 8."""
    return exact_flow(system) if system is ORBITS else Integrated(system, INTEGRATORS["kahan_li8"])


SEEN = {
    "spring": (SPRING, Position(1), [0.01], [0.05, 0.05]),
    "tracking": (ORBITS, GroundStation(52.0, 13.0), [1e-2, 1e-5, 1e-5], [0.5] * 3 + [5e-4] * 3),
}


@pytest.mark.parametrize("name", SEEN)
def test_with_the_exact_flow_it_is_consistent(name):
    system, model, sd, start = SEEN[name]
    assert len(sd) == len(model.names)
    start = torch.tensor(start, dtype=F64) * torch.tensor([1.0] * system.dof + [system.inertia] * system.dof)
    setting = Setting(model, torch.tensor(sd, dtype=F64), start, tuple(range(5, system.steps + 1, 5)))
    flow, members = accurate(system), 60
    states = [system.initial_states(members, torch.Generator().manual_seed(3))]
    for _ in range(system.steps):
        states.append(flow(states[-1], system.dt))
    arcs = perturbed_arcs(setting, torch.stack(states, 1), system.dt, members, None, seed=4)
    nothing = torch.zeros(2 * system.dof, 2 * system.dof, dtype=F64)
    chosen = Filter("exact", flow, nothing, setting.measurement_noise, ExtendedKalmanFilter())
    result = assimilate(chosen, setting, arcs)
    assert not bool(result.status.any())
    last = nees(result.means - arcs.truth[:, 1:], result.chols)[:, -1]
    low, high = (chi2.ppf(p, members * 2 * system.dof) / members for p in (1e-4, 1 - 1e-4))
    assert low < float(last.mean()) < high


def learned():
    torch.manual_seed(0)
    options = {
        "inertia": 2.0,
        "mu": None,
        "inputs": "cartesian",
        "scaling": "none",
        "network": {"width": 8, "depth": 2, "activation": "tanh"},
    }
    return make_dynamics(
        "hamiltonian", dof=2, hamiltonian="generic", **options, integrator={"name": "rk4"}
    ).frozen()


def test_the_transition_of_a_learned_flow_is_that_of_differences_however_it_is_wrapped():
    flow, x = learned(), 0.3 * draw(3, 4)
    with torch.no_grad():
        value, moved = transition(flow, x, 0.1)
        torch.testing.assert_close(value, flow(x, 0.1), rtol=1e-13, atol=1e-13)
        offsets = 1e-5 * torch.eye(4, dtype=F64)
        columns = [(flow(x + d, 0.1) - flow(x - d, 0.1)) / 2e-5 for d in offsets]
        torch.testing.assert_close(moved, torch.stack(columns, -1), rtol=1e-7, atol=1e-8)
        longer = ForceError(0.1, 1.0).flow(recorded(flow)), torch.nn.functional.pad(x, (0, 2))
        for other, at in ((recorded(flow), x), (lambda x, dt: flow(x, dt), x), longer):
            found = transition(other, at, 0.1)[1][:, :4, :4]
            torch.testing.assert_close(found, moved, rtol=1e-9, atol=1e-9)


def test_a_force_error_and_parameters_are_states_of_it_too():
    """The state of a wrong spring: what is off by a constant factor is found where parameters are states."""
    truth = accurate(SPRING)
    states = [torch.tensor([[1.0, 0.0]], dtype=F64).expand(40, -1)]
    for _ in range(80):
        states.append(truth(states[-1], SPRING.dt))
    along = torch.stack(states, 1)
    sd = torch.tensor([0.05, 0.05], dtype=F64)
    setting = Setting(Position(1), torch.tensor([0.01], dtype=F64), sd, tuple(range(2, 81, 2)))
    arcs = perturbed_arcs(setting, along, SPRING.dt, 40, None, seed=1)
    wrong = accurate(replace(SPRING, stiffness=1.1 * SPRING.stiffness))
    noise = 1e-12 * torch.eye(2, dtype=F64), setting.measurement_noise
    plain = Filter("f", wrong, *noise, ExtendedKalmanFilter())

    def columns(x):
        force = 0.1 * SPRING.stiffness * x[..., :1]
        return torch.stack((torch.zeros_like(force), force), dim=-2)

    kinds = {"none": None, "force": ForceError(0.1, 1.0, SPRING.inertia), "known": ParameterError(columns, 1)}
    mean = {}
    for name, error in kinds.items():
        result = assimilate(plain._replace(force_error=error), setting, arcs)
        assert result.means.shape == (40, 80, 2)
        mean[name] = float(nees(result.means - along[:, 1:], result.chols)[:, 40:].mean())
    assert mean["none"] > 50
    assert mean["force"] < 4
    assert 0.8 < mean["known"] < 3.5


def test_its_gate_ends_a_member_that_refuses_too_much():
    rows = torch.full((2, 6, 1), 0.5, dtype=F64)
    rows[1, 2:] = 100.0
    belief = initial_belief([[0.5, 0.0]] * 2, 0.01 * np.eye(2))
    options = (Position(1), 1e-8 * np.eye(2), [[1e-2]], 0.1)
    result = ExtendedKalmanFilter(Gate(0.999, 3)).run(lambda x, _: x, belief, rows, *options)
    assert result.status.tolist() == [Status.OK, Status.DIVERGED]
    assert result.failed_step.tolist() == [-1, 4]


def test_a_flow_or_a_model_that_returns_another_shape_is_refused():
    belief = initial_belief([[0.5, 0.0]], np.eye(2))
    ekf, rest = ExtendedKalmanFilter(), ([[[0.0]]], Position(1), np.eye(2), [[1.0]], 0.1)
    with pytest.raises(ValueError, match="flow: expected flow"):
        ekf.run(lambda x, _: x[:, :1], belief, *rest)
    with pytest.raises(ValueError, match="state: expected a FilterState"):
        ekf.predict(belief, swing, 0.1, np.eye(2))
    with pytest.raises(ValueError, match="gate: expected a Gate"):
        ExtendedKalmanFilter(0.9)
    assert ekf.about != ExtendedKalmanFilter(Gate()).about
    assert State(1).names


@pytest.mark.parametrize("system", [SPRING, ORBITS], ids=["spring", "orbits"])
def test_the_transition_of_an_exact_flow_is_that_of_reverse_mode(system):
    flow, x = exact_flow(system), system.initial_states(2, torch.Generator().manual_seed(0))
    value, moved = transition(flow, x, system.dt)
    exact = pointwise_jacobian(lambda z: flow(z, system.dt), x)
    torch.testing.assert_close(value, flow(x, system.dt), rtol=1e-12, atol=1e-9)
    scale = system.deviations()
    assert float(((moved - exact) * scale / scale.unsqueeze(-1)).abs().max()) < 1e-7
