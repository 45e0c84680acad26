"""Residuals on windows: recursive ones compare predictions, derivative ones are exact on polynomials."""

from __future__ import annotations

import pytest
import torch
from helpers import MOLNIYA, SPRING, batch_of, close, data_module, generator, ready_model

from ahnn.errors import UserError
from ahnn.integrators import INTEGRATORS
from ahnn.training.objectives import Loss, derivative_samples, difference_weights, recursive_residuals
from ahnn.types import Window


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
    expected = (batch.dt * model.learner(middle) - target) / model.loss_scale
    close(model.residuals(batch).flatten(), expected.flatten(), 1e-12)


def test_recursive_residuals_are_the_prediction_minus_the_data(cache):
    data = data_module(MOLNIYA, cache, window=4)
    batch = batch_of(data)
    model = ready_model("generic", data)
    got = recursive_residuals(model.increment, batch)
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
    expected = model.increment(batch.start, batch.dt) - batch.increments[:, 0]
    assert torch.equal(recursive_residuals(model.increment, batch)[:, 0], expected)
    close(model.residuals(batch)[:, 0], expected / model.loss_scale, 1e-15)


def test_residuals_of_the_truth_vanish(cache):
    data = data_module(MOLNIYA, cache, window=5)
    batch = batch_of(data)
    residuals = recursive_residuals(lambda x, dt: INTEGRATORS["kahan_li8"].increment(MOLNIYA, x, dt), batch)
    assert float((residuals / data.statistics().increment).abs().max()) < 1e-10


def test_float32_residuals_keep_their_digits(cache):
    data = data_module(MOLNIYA, cache, window=5)
    batch = batch_of(data, 64)
    single = Window(batch.start.float(), batch.increments.float(), batch.dt)

    def almost(x, dt):  # an increment that is wrong by a millionth
        return INTEGRATORS["rk4"].increment(MOLNIYA, x, dt) * (1 + 1e-6)

    double = recursive_residuals(almost, batch)
    naive_error = 60_000 * torch.finfo(torch.float32).eps  # what subtracting two states would leave
    error = recursive_residuals(almost, single).double() - double
    assert float(error[..., :3].square().mean().sqrt()) < naive_error / 10


@pytest.mark.parametrize("kind", ["increment", "state"])
def test_the_loss_scale_is_the_increment_or_half_the_range(cache, kind):
    data = data_module(SPRING, cache)
    statistics = data.statistics()
    model = ready_model("generic", data, loss={"scale": kind})
    half = (statistics.maximum - statistics.minimum) / 2
    close(model.loss_scale, statistics.increment if kind == "increment" else half, 1e-15)


def test_the_loss_is_huber_on_scaled_residuals():
    r = torch.tensor([[[0.5, -3.0]]])
    assert float(Loss(delta=1.0)(r)) == pytest.approx((0.5 * 0.25 + (3.0 - 0.5)) / 2)
    assert float(Loss(delta=10.0)(r)) == pytest.approx((0.25 + 9.0) / 4)


def test_a_balanced_loss_measures_slow_and_fast_parts_alike():
    targets = torch.tensor([[[1.0, 1.0]], [[10.0, 10.0]]], dtype=torch.float64)
    scale = torch.tensor([2.0, 4.0], dtype=torch.float64)
    close(Loss().weights(targets, scale), (1 / scale).expand(2, 1, 2), 1e-15)
    residuals = 0.01 * targets * scale
    close(residuals * Loss(balance=1.0).weights(targets * scale, scale), torch.full((2, 1, 2), 0.01), 1e-3)


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
    with pytest.raises(UserError, match=rf"loss.*{name}\D+{value}"):
        Loss(**wrong)
