"""What residuals say of a wrong data.noise and of outliers, and that they say nothing of wrong dynamics."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from cases import SPRING, trajectories
from test_goodness_of_fit import Spring, measured

from ahnn.data.segments import Segments
from ahnn.data.sensor import Sensor
from ahnn.evaluation.residual_diagnosis import diagnosis, remedy, verdicts
from ahnn.evaluation.residual_tests import residual_tests

FOLLOWS = "of the residual variance depends on the state: the model misses part of the motion"


def stated(batch, *factors):
    """Return measurements whose noise is said to be so many times what it is."""
    deviations = batch.instrument.deviations * torch.tensor(factors, dtype=torch.float64)
    return batch._replace(instrument=batch.instrument._replace(deviations=deviations))


@pytest.mark.parametrize("factor", [0.02, 0.1, 0.6, 1.7, 10.0])
def test_noise_that_is_off_is_named(factor):
    said = remedy(Spring(SPRING), stated(measured(), factor), "none")
    head, _, tail = said.partition(" times too ")
    found = float(head.removeprefix("data.noise is about "))
    assert tail == f"{'small' if factor < 1 else 'large'} for q (data.noise=estimate finds it)"
    assert found == pytest.approx(max(factor, 1 / factor), rel=0.1)


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.25])
def test_noise_within_a_factor_of_a_quarter_is_not_spoken_of(factor):
    assert remedy(Spring(SPRING), stated(measured(), factor), "none") == ""


def test_of_several_numbers_the_one_that_is_off_is_named():
    batch = measured(kind="state")
    assert remedy(Spring(SPRING), stated(batch, 1.0, 0.1), "none").endswith(
        "times too small for p (data.noise=estimate finds it)"
    )


@pytest.mark.parametrize("factor", [1.0, 0.1])
def test_outliers_are_named_where_the_training_counted_them(factor):
    batch = stated(measured(outliers=0.05, gaps=0.2), factor)
    said = remedy(Spring(SPRING), batch, "none").split("; ")
    assert len(said) == (1 if factor == 1 else 2)
    share, _, rest = said[-1].partition(" % of the values are outliers: ")
    assert float(share) == pytest.approx(5, abs=1.5)
    assert rest == "set loss.robust=student to downweight them, or data.tails=estimate to model them"
    assert "outliers" not in remedy(Spring(SPRING), batch, "student")


@pytest.mark.slow
@pytest.mark.parametrize("every", [80, 95, 110])
def test_wrong_dynamics_are_no_noise_a_quarter_of_a_period_apart(every):
    """Where residuals in a row do not correlate, those further apart do."""
    system = dataclasses.replace(SPRING, steps=1600)
    sensor = Sensor(system.space, measured="position", noise=0.01, every=every)
    seen = sensor.measure(trajectories(system, 40, 5), 0)
    batch = Segments(seen, None, sensor.instrument(system.dt)).gather(torch.arange(40))
    assert remedy(Spring(system), batch, "none") == ""
    for stiffness in (1.12, 1.3):
        softer = dataclasses.replace(system, stiffness=stiffness * system.stiffness)
        assert remedy(Spring(softer), batch, "none").endswith(FOLLOWS)


def test_what_fitted_starts_take_up_is_no_noise():
    batch = measured()
    for samples in (2, 3, 4):
        few = batch._replace(
            values=batch.values[:, ::10][:, :samples], times=batch.times[:, ::10][:, :samples]
        )
        assert remedy(Spring(SPRING), few, "none") == ""


def test_wrong_dynamics_are_no_noise():
    stiffer = dataclasses.replace(SPRING, stiffness=5.6)
    assert remedy(Spring(stiffer), measured(), "none").endswith(FOLLOWS)
    said = remedy(Spring(stiffer), stated(measured(), 3e2), "none")
    assert said.startswith("data.noise is about 2.5e+02 times too large for q; ")
    assert said.endswith(FOLLOWS)
    assert float(trajectories(SPRING, 1, 5).states.abs().max()) > 0.1  # far above the noise


def coloured(correlation, seed=0):
    """Return measurements with noise of the stated size that is correlated in time."""
    batch, draw = measured(noise=1e-9), torch.Generator().manual_seed(seed)
    white = torch.randn(batch.values.shape, generator=draw, dtype=torch.float64)
    noise = white.clone()
    for k in range(1, white.shape[1]):
        noise[:, k] = correlation * noise[:, k - 1] + (1 - correlation**2) ** 0.5 * white[:, k]
    return stated(batch._replace(values=batch.values + 0.01 * noise), 1e7)


def one_of(batch, samples):
    """Return the beginning of one trajectory."""
    return batch._replace(values=batch.values[:1, :samples], times=batch.times[:1, :samples])


def test_few_unseen_measurements_are_diagnosed_with_those_of_the_training():
    training, unseen = coloured(0.75), one_of(coloured(0.75, seed=1), 14)
    assert "coloured" not in remedy(Spring(SPRING), unseen, "none")
    assert "the noise is coloured" in diagnosis(Spring(SPRING), unseen, training, "none")
    assert diagnosis(Spring(SPRING), unseen, None, "none") == remedy(Spring(SPRING), unseen, "none")
    many = stated(coloured(0.0), 0.2)  # enough of them: the training does not count
    assert diagnosis(Spring(SPRING), many, training, "none") == remedy(Spring(SPRING), many, "none")
    assert "coloured" not in remedy(Spring(SPRING), many, "none")


def test_a_model_that_fits_its_training_alone_needs_more_of_it():
    unseen = one_of(coloured(0.0, seed=3), 25)
    unseen = unseen._replace(values=unseen.values + 0.05 * torch.sin(1.3 * torch.arange(25.0))[None, :, None])
    said = diagnosis(Spring(SPRING), unseen, coloured(0.0), "none")
    assert said.startswith("the measurements of the training have ")
    assert said.endswith("so that more trajectories would help")


@pytest.mark.parametrize(("pairs", "correlation", "said"), [(35, 0.7, 0), (4000, 0.7, 1), (100, 0.0, 1)])
def test_the_size_of_a_few_correlated_residuals_is_chance(pairs, correlation, said):
    draw = torch.randn(6, 50, 2, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    times = torch.arange(50.0).double().expand(6, -1)
    found = residual_tests(draw[..., :1], draw.roll(1, 0), times, 2)
    one = torch.ones(1, dtype=torch.float64)
    found = found._replace(scale=1.7 * one, correlation=correlation * one, pairs=(pairs * one).long())
    words = [text for text in verdicts(found, ("q",), 0.1, "none") if "1.7 times too small" in text]
    assert len(words) == said
