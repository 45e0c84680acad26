"""Biases of sensors as states: the linear Kalman filter of the longer state is the oracle."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from ahnn.errors import UserError
from ahnn.estimation import initial_belief
from ahnn.estimation.batch_least_squares import batch_least_squares
from ahnn.estimation.covariances import Factor
from ahnn.estimation.process_model import Process
from ahnn.estimation.scenario import Setting, simulated
from ahnn.estimation.sensor_error import SensorError
from ahnn.measurements import Biases, GroundStation, Position, Several, State
from ahnn_plugins.ekf import ExtendedKalmanFilter
from ahnn_plugins.ukf import UnscentedKalmanFilter

DT, SD, BIAS, MEMORY = 0.5, 0.1, 0.3, 4.0
F = np.array([[1.0, DT], [0.0, 1.0]])
Q = np.diag([1e-3, 4e-3])
MODEL = State(1, ("m", "m/s"))
ESTIMATORS = [UnscentedKalmanFilter(), ExtendedKalmanFilter()]


def coast(x, dt):
    return torch.stack((x[:, 0] + dt * x[:, 1], x[:, 1]), dim=-1)


def error(memory=math.inf):
    """A bias of the position that a sensor of position and velocity reads."""
    made = SensorError.of({"": Biases((BIAS, 0.0), (memory, math.inf))})
    assert made is not None
    return made


def augmented(found):
    kept = math.exp(-DT / float(found.memories[0]))
    f = np.block([[F, np.zeros((2, 1))], [np.zeros((1, 2)), np.array([[kept]])]])
    q = np.block([[Q, np.zeros((2, 1))], [np.zeros((1, 2)), np.array([[BIAS**2 * (1 - kept**2)]])]])
    return f, q, np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]])


def kalman(found, mean, p, rows):
    """Textbook filter of the three states (x, v, b)."""
    (f, q, h), r = augmented(found), np.diag([SD**2, SD**2])
    means = []
    for y in rows:
        mean, p = f @ mean, f @ p @ f.T + q
        gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
        mean, p = mean + gain @ (y - h @ mean), (np.eye(3) - gain @ h) @ p
        means.append(mean)
    return np.array(means), p


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda one: one.name)
@pytest.mark.parametrize("memory", [math.inf, MEMORY])
def test_a_filter_of_biases_is_the_kalman_filter_of_the_longer_state(estimator, memory):
    found = error(memory)
    rows = np.random.default_rng(0).normal(size=(12, 2))
    belief = found.belief(initial_belief([[1.0, 0.3]], np.diag([0.5, 0.2])))
    q = found.process_noise(torch.tensor(Q), DT)
    model, r = found.measurement(MODEL), np.diag([SD**2, SD**2])
    result = estimator.run(found.flow(coast), belief, rows[None], model, q, r, DT)
    expected, p = kalman(found, np.array([1.0, 0.3, 0.0]), np.diag([0.5, 0.2, BIAS**2]), rows)
    np.testing.assert_allclose(result.means[0].numpy(), expected, rtol=1e-9, atol=1e-12)
    chol = result.chols[0, -1].numpy()
    np.testing.assert_allclose(chol @ chol.T, p, rtol=1e-9, atol=1e-14)


def test_least_squares_finds_a_constant_bias_as_far_as_prior_and_measurements_say():
    found = error()
    rows = np.random.default_rng(1).normal(size=(9, 2))
    prior = np.diag([0.5, 0.2, BIAS**2])
    belief = found.belief(initial_belief([[1.0, 0.3]], np.diag([0.5, 0.2])))
    fit = batch_least_squares(
        found.flow(coast), belief, rows[None], found.measurement(MODEL), np.eye(2) * SD**2, DT
    )
    f, _, h = augmented(found)
    root = np.linalg.inv(np.linalg.cholesky(prior))
    design = [root, *(h @ np.linalg.matrix_power(f, k + 1) / SD for k in range(len(rows)))]
    wanted = [root @ [1.0, 0.3, 0.0], *(rows / SD)]
    start = np.linalg.lstsq(np.vstack(design), np.concatenate(wanted), rcond=None)[0]
    np.testing.assert_allclose(fit.initial.mean[0].numpy(), start, rtol=1e-7)
    assert fit.of_states(2).means.shape == (1, 9, 2)


@pytest.mark.parametrize("memory", [math.inf, MEMORY])
def test_simulated_biases_have_the_law_that_filters_believe(memory):
    setting = Setting(MODEL, torch.tensor([1e-9, 1e-9]), torch.ones(2), tuple(range(1, 41)), error(memory))
    truth = torch.zeros(4000, 41, 2, dtype=torch.float64)
    seen = simulated(setting, truth, DT, seed=3)
    assert float(seen[..., 1].abs().max()) < 1e-7
    variance = seen[..., 0].square().mean(0) / BIAS**2
    assert float((variance - 1).abs().max()) < 0.15  # 4,000 draws: 0.022 each
    lag = (seen[:, 1:, 0] * seen[:, :-1, 0]).mean() / seen[..., 0].square().mean()
    assert float(lag) == pytest.approx(math.exp(-DT / memory), abs=0.01)


def test_several_sensors_have_biases_of_their_own():
    found = SensorError.of({"a": Biases((0.0, 2.0), (1.0, 5.0)), "b": None, "c": Biases((3.0,), (math.inf,))})
    assert found is not None
    assert found.about == [[2.0, 3.0], [5.0, math.inf]]
    x = torch.tensor([[10.0, 20.0, 0.5, 0.25]], dtype=torch.float64)
    seen = {name: found.measurement(model, name)(x, 0.0) for name, model in {"a": MODEL, "b": MODEL}.items()}
    assert seen["a"].tolist() == [[10.0, 20.5]]
    assert seen["b"].tolist() == [[10.0, 20.0]]
    assert found.measurement(Position(1, "m"), "c")(x, 0.0).tolist() == [[10.25]]
    assert SensorError.of({"a": None}) is None


def test_a_factor_of_process_noise_has_the_square_that_is_said():
    found = error(MEMORY)
    q = found.process_noise(torch.tensor(Q), DT)
    process = found.process(Process(UnscentedKalmanFilter(), coast, lambda dt: Q * dt / DT, DT))
    noise = process.noise(DT)
    assert isinstance(noise, Factor)
    torch.testing.assert_close(noise.chol @ noise.chol.mT, q)


def test_biases_are_said_for_all_components_for_each_or_for_one_station_of_several():
    station = GroundStation(60.0, 30.0)
    both = Several([station, station])
    assert Biases.of(both, [0.1, 0.0, 2.0], None) == Biases((0.1, 0.0, 2.0) * 2, (math.inf,) * 6)
    assert Biases.of(MODEL, 0.5, [1.0, 2.0]) == Biases((0.5, 0.5), (1.0, 2.0))
    assert Biases.of(MODEL, None, None) is None


@pytest.mark.parametrize(
    ("sd", "memory", "said"),
    [
        (None, 3.0, "bias_memory: expected bias_sd with 3.0; received none"),
        ([0.1, 0.2, 0.3], None, "bias_sd: expected standard deviations of biases"),
        ([0.0, 0.0], None, "not all 0"),
        (-1.0, None, "bias_sd: expected"),
        (math.nan, None, "bias_sd: expected"),
        ("a", None, "bias_sd: expected"),
        (b"a", None, "bias_sd: expected"),
        (["a", "b"], None, "bias_sd: expected"),
        ([None, 1.0], None, "bias_sd: expected"),
        (True, None, "bias_sd: expected"),
        (0.1, "x", "bias_memory: expected times > 0"),
        (0.1, 0.0, "bias_memory: expected times > 0"),
        (0.1, [1.0, 2.0, 3.0], "bias_memory: expected times > 0"),
    ],
)
def test_biases_that_are_none_are_refused(sd, memory, said):
    with pytest.raises(UserError) as error:
        Biases.of(MODEL, sd, memory)
    assert said in str(error.value)
