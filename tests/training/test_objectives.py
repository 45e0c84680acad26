"""Residuals on windows: recursive ones compare predictions, derivative ones are exact on polynomials."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch
from helpers import MOLNIYA, SPRING, SYSTEMS, batch_of, close, data_module, generator, ready_model

from ahnn.dynamics.base import Dynamics
from ahnn.errors import UserError
from ahnn.integrators import INTEGRATORS
from ahnn.training import FirstOrder, Loss, LossOptions, Recursive
from ahnn.training.least_squares import recursive_problem
from ahnn.training.objectives import Derivative, derivative_samples, difference_weights
from ahnn.types import Window


class Exact(Dynamics):
    """Increments of the true Molniya field, wrong by a factor 1 + error."""

    def __init__(self, integrator, error=0.0):
        super().__init__()
        self.integrator, self.error = INTEGRATORS[integrator], error

    def fit(self, statistics):
        pass

    def increment(self, x, dt):
        return self.integrator.increment(MOLNIYA, x, dt) * (1 + self.error)


def physical(dynamics, batch):
    """Recursive residuals in physical units."""
    unit = Loss(batch.start.shape[-1], LossOptions()).to(batch.start)
    return Recursive(unit, batch.increments.shape[1]).residuals(dynamics, batch)


def polynomial_window(degree, steps, dt=0.3):
    """Samples of a random polynomial in time, and its value and slope in the middle, each (B, D)."""
    c = torch.randn(degree + 1, 4, 2, generator=generator(degree), dtype=torch.float64)
    t = torch.arange(steps + 1, dtype=torch.float64) * dt
    powers = torch.stack([t**k for k in range(degree + 1)])
    x = torch.einsum("kbd,kt->btd", c, powers)
    middle = steps * dt / 2
    value = sum(c[k] * middle**k for k in range(degree + 1))
    slope = sum((k * c[k] * middle ** (k - 1) for k in range(1, degree + 1)), torch.zeros(4, 2))
    return Window(x[:, 0], x.diff(dim=1), dt), value, slope


@pytest.mark.parametrize("steps", [2, 4, 6, 8, 12])
def test_derivatives_are_exact_for_polynomials_up_to_the_order(steps):
    for degree in range(steps + 1):
        window, value, slope = polynomial_window(degree, steps)
        middle, target = derivative_samples(window)
        size = float(window.start.abs().max() + window.increments.abs().max())
        assert middle.shape == target.shape == (4, 2)
        assert float((target - window.dt * slope).abs().max()) < 1e-13 * size
        assert float((middle - value).abs().max()) < 1e-13 * size


@pytest.mark.parametrize(
    ("steps", "central"),
    [
        (2, [-1 / 2, 0, 1 / 2]),
        (4, [1 / 12, -8 / 12, 0, 8 / 12, -1 / 12]),
        (6, [-1 / 60, 9 / 60, -45 / 60, 0, 45 / 60, -9 / 60, 1 / 60]),
    ],
)
def test_derivatives_are_the_central_difference(steps, central):
    samples = torch.randn(steps + 1, generator=generator(steps), dtype=torch.float64)
    expected = sum(c * s for c, s in zip(central, samples, strict=True))
    assert float(difference_weights(steps) @ samples.diff()) == pytest.approx(float(expected), rel=1e-13)


@pytest.mark.parametrize("structure", ["generic", "separable"])
def test_derivative_residuals_compare_the_field_with_the_data(cache, structure):
    data = data_module(SPRING, cache, window=4)
    model = ready_model(structure, data, loss={"derivative": 1.0})
    batch = batch_of(data)
    middle, target = derivative_samples(batch)
    expected = (batch.dt * model.dynamics.field(middle) - target) / model.loss.unit
    close(model.objective.residuals(model.dynamics, batch).flatten(), expected.flatten(), 1e-12)


def test_recursive_residuals_are_the_prediction_minus_the_data(cache):
    data = data_module(MOLNIYA, cache, window=4)
    batch = batch_of(data)
    model = ready_model("generic", data)
    got = physical(model.dynamics, batch)
    x, truth = batch.start, batch.start
    expected = []
    for k in range(4):
        x, truth = model(x, batch.dt), truth + batch.increments[:, k]
        expected.append(x - truth)
    close(got, torch.stack(expected, 1), 1e-8)


def test_a_window_of_one_step_gives_the_one_step_residual(cache):
    data = data_module(SPRING, cache, window=1)
    batch = batch_of(data)
    model = ready_model("node", data)
    expected = model.dynamics.increment(batch.start, batch.dt) - batch.increments[:, 0]
    assert torch.equal(physical(model.dynamics, batch)[:, 0], expected)
    close(model.objective.residuals(model.dynamics, batch)[:, 0], expected / model.loss.unit, 1e-15)


def test_residuals_of_the_truth_vanish(cache):
    data = data_module(MOLNIYA, cache, window=5)
    batch = batch_of(data)
    residuals = physical(Exact("kahan_li8"), batch)
    assert float((residuals / data.statistics().increment).abs().max()) < 1e-10


def test_float32_residuals_keep_their_digits(cache):
    data = data_module(MOLNIYA, cache, window=5)
    batch = batch_of(data, 64)
    single = Window(batch.start.float(), batch.increments.float(), batch.dt)

    almost = Exact("rk4", 1e-6)
    double = physical(almost, batch)
    naive_error = 60_000 * torch.finfo(torch.float32).eps  # what subtracting two states would leave
    error = physical(almost, single).double() - double
    assert float(error[..., :3].square().mean().sqrt()) < naive_error / 10


@pytest.mark.parametrize("kind", ["increment", "state"])
def test_the_loss_scale_is_the_increment_or_half_the_range(cache, kind):
    data = data_module(SPRING, cache)
    statistics = data.statistics()
    model = ready_model("generic", data, loss={"scale": kind})
    half = (statistics.maximum - statistics.minimum) / 2
    close(model.loss.unit, statistics.increment if kind == "increment" else half, 1e-15)


def test_the_loss_is_huber_on_scaled_residuals():
    r = torch.tensor([[[0.5, -3.0]]])
    assert float(Loss(2, LossOptions(delta=1.0))(r)) == pytest.approx((0.5 * 0.25 + (3.0 - 0.5)) / 2)
    assert float(Loss(2, LossOptions(delta=10.0))(r)) == pytest.approx((0.25 + 9.0) / 4)


def test_a_balanced_loss_measures_slow_and_fast_parts_alike():
    targets = torch.tensor([[[1.0, 1.0]], [[10.0, 10.0]]], dtype=torch.float64)
    unit = torch.tensor([2.0, 4.0], dtype=torch.float64)
    plain, balanced = (Loss(2, LossOptions(balance=b)).double() for b in (0.0, 1.0))
    plain.unit.copy_(unit)
    balanced.unit.copy_(unit)
    close(plain.weights(targets), (1 / unit).expand(2, 1, 2), 1e-15)
    close(0.01 * targets * unit * balanced.weights(targets * unit), torch.full((2, 1, 2), 0.01), 1e-3)


@pytest.mark.parametrize(
    "wrong",
    [
        {"scale": "states"},
        {"delta": 0.0},
        {"delta": float("nan")},
        {"balance": -0.5},
        {"balance": 1.5},
        {"derivative": -0.1},
        {"derivative": 1.1},
        {"order": 3},
        {"order": 0},
    ],
)
def test_impossible_losses_are_refused_with_what_came(wrong):
    ((name, value),) = wrong.items()
    with pytest.raises(UserError, match=rf"^{name}: expected .*; received '?{value}"):
        LossOptions(**wrong)


@pytest.mark.parametrize("name", ["node", "separable"])
def test_steps_that_differ_give_the_residuals_of_each_step_alone(cache, name):
    data = data_module(SPRING, cache, window=3)
    batch = batch_of(data, 6)
    model = ready_model(name, data)
    steps = 0.01 + 0.02 * torch.rand(6, 3, generator=generator(5), dtype=torch.float64)
    objective = model.objective
    got = objective.residuals(model.dynamics, batch._replace(dt=steps))
    for b in range(6):
        x, error = batch.start[b : b + 1], 0.0
        for k in range(3):
            predicted = model.dynamics.increment(x, float(steps[b, k]))
            x, error = x + predicted, error + predicted - batch.increments[b, k]
            close(got[b : b + 1, k], error / model.loss.unit, 1e-11)
    theta = torch.nn.utils.parameters_to_vector(model.dynamics.parameters()).detach()
    problem = objective.problem(model.dynamics, batch._replace(dt=steps))
    close(problem.residuals(theta), got.flatten(), 1e-14)


def test_the_jacobian_with_steps_that_differ_is_the_central_difference(cache):
    data = data_module(SPRING, cache, window=3)
    model, batch = ready_model("generic", data), batch_of(data, 4)
    batch = batch._replace(dt=0.01 + 0.02 * torch.rand(4, 3, generator=generator(5), dtype=torch.float64))
    problem = model.objective.problem(model.dynamics, batch)
    theta = torch.nn.utils.parameters_to_vector(model.dynamics.parameters()).detach()
    along = torch.randn(len(theta), generator=generator(1), dtype=torch.float64)
    numeric = (problem.residuals(theta + 1e-5 * along) - problem.residuals(theta - 1e-5 * along)) / 2e-5
    close(problem.jacobian(theta).double() @ along, numeric, 1e-4)


def test_derivatives_refuse_steps_that_differ(cache):
    data = data_module(SPRING, cache, window=4)
    batch = batch_of(data)
    with pytest.raises(UserError, match=r"equal steps .*received unequal steps.*loss.derivative=0"):
        derivative_samples(batch._replace(dt=torch.full(batch.increments.shape[:2], 0.01)))


KINDS = ("node", "generic", "separable", "mechanical", "central_body")


@pytest.mark.parametrize("kind", KINDS)
def test_the_jacobian_of_derivative_residuals_is_the_central_difference(cache, kind):
    """Rows that no parameter moves, those of dq/dt where the kinetic energy is known, are zero."""
    data = data_module(SYSTEMS["kepler"] if kind == "central_body" else SPRING, cache, window=4)
    model, batch = ready_model(kind, data), batch_of(data, 6)
    problem = Derivative(model.loss, 4).problem(model.dynamics, batch)
    theta = torch.nn.utils.parameters_to_vector(model.dynamics.parameters()).detach()
    along = torch.randn(len(theta), generator=generator(1), dtype=torch.float64)
    numeric = (problem.residuals(theta + 1e-5 * along) - problem.residuals(theta - 1e-5 * along)) / 2e-5
    assert float(numeric.abs().max()) > 0
    close(problem.jacobian(theta).double() @ along, numeric, 1e-4)
    close(
        problem.residuals(theta), Derivative(model.loss, 4).residuals(model.dynamics, batch).flatten(), 1e-13
    )


def test_the_jacobian_of_other_increments_than_those_of_the_dynamics_is_theirs(cache):
    data = data_module(SPRING, cache, window=2)
    model, batch = ready_model("generic", data), batch_of(data, 4)
    theta = torch.nn.utils.parameters_to_vector(model.dynamics.parameters()).detach()
    along = torch.randn(len(theta), generator=generator(1), dtype=torch.float64)
    weights = torch.ones_like(batch.increments)
    dynamics = model.dynamics
    for increment in (dynamics.increment, lambda x, dt: 3 * dynamics.increment(x, 2 * dt)):
        problem = recursive_problem(dynamics, increment, batch, weights)
        numeric = (problem.residuals(theta + 1e-5 * along) - problem.residuals(theta - 1e-5 * along)) / 2e-5
        close(problem.jacobian(theta).double() @ along, numeric, 1e-4)


@pytest.mark.parametrize("weight", [None, 1, 0.25, 3.0])
def test_a_batch_counts_by_its_weight_and_one_without_as_it_is(weight):
    batch = SimpleNamespace() if weight is None else SimpleNamespace(weight=weight)
    objective = SimpleNamespace(residuals=lambda *_: torch.tensor(0.7))
    value = FirstOrder().step(objective, torch.nn.Identity(), None, batch, None)
    assert float(value) == pytest.approx(0.7 * (1 if weight is None else weight), rel=1e-6)
