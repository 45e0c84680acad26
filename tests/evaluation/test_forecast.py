"""Forecasts from a fit to the first half: against dense linear algebra, and counted over many paths."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from cases import SPRING, Learned, make_case, trajectories
from helpers import close, generator
from torch import nn

from ahnn.data.segments import whole
from ahnn.data.sensor import Sensor
from ahnn.evaluation import evaluate
from ahnn.evaluation.forecast import at, first_part, forecast
from ahnn.measurements import Segment
from ahnn.rollouts import rollout
from ahnn.types import Trajectories
from ahnn.uncertainty import Uncertainty, bands

EVERY, NOISE = 4, 0.05
DOUBLE = {"dtype": torch.float64}
LONG = dataclasses.replace(SPRING, steps=400)


def measured(truth, kind="position", **options):
    sensor = Sensor(SPRING.space, measured=kind, noise=NOISE, every=EVERY, **options)
    return whole(sensor.measure(truth, 0), sensor.instrument(SPRING.dt))


def known(sd):
    return torch.tensor([[sd]], **DOUBLE)


def test_bands_of_the_right_model_hold_what_normal_errors_have():
    truth = trajectories(LONG, 400, 3)
    found = forecast(Learned(LONG.stiffness), measured(truth), known(1e-9), truth=truth)
    assert found is not None
    assert (found.trajectories, found.lost) == (400, 0)
    assert found.coverage == pytest.approx((0.6827, 0.9545, 0.9973), abs=0.012)
    assert found.states == pytest.approx((0.6827, 0.9545, 0.9973), abs=0.03)
    assert found.width > 1.0
    for (low, high), share in zip(found.right, found.states, strict=True):
        assert low <= share <= high
        assert high - low < 0.06  # four directions of the noise each, 400 times


def test_forecasts_of_heavy_tailed_measurements_have_bands_of_that_noise():
    """With 3 degrees of freedom a normal band of the same scale holds 61 % and 86 %."""
    truth = trajectories(LONG, 200, 3)
    segment = measured(truth, freedom=3.0)
    freedom = torch.tensor([3.0], **DOUBLE)
    student = segment._replace(instrument=segment.instrument._replace(freedom=freedom))
    plain, right = (
        forecast(Learned(LONG.stiffness), one, known(1e-9), truth=truth) for one in (segment, student)
    )
    assert plain is not None
    assert right is not None
    assert plain.coverage[1] < 0.89
    assert right.coverage == pytest.approx((0.6827, 0.9545, 0.9973), abs=0.012)
    assert right.states == pytest.approx((0.6827, 0.9545, 0.9973), abs=0.04)


def test_right_bands_of_forecasts_hold_all_or_few_where_parameters_are_all_that_is_uncertain():
    truth = trajectories(LONG, 20, 3)
    few, many = (
        forecast(Learned(LONG.stiffness), measured(truth), known(sd), truth=truth) for sd in (9.0, 0.01)
    )
    assert few is not None
    assert many is not None
    assert few.parameters > 0.99
    assert few.right[0][0] < 0.1
    assert few.right[0][1] > 0.9
    assert many.parameters < 0.1
    assert many.right[0][0] > 0.5
    assert many.right[0][1] < 0.9


def test_what_is_known_of_the_parameters_counts():
    truth = trajectories(LONG, 100, 3)
    learned, segment = Learned(LONG.stiffness + 0.6), measured(truth)
    without, beside = (forecast(learned, segment, known(sd), truth=truth) for sd in (1e-9, 0.6))
    assert without is not None
    assert beside is not None
    assert without.coverage[1] < 0.8
    assert without.states is not None
    assert without.states[1] < 0.5
    assert beside.coverage[1] > 0.95
    assert beside.states is not None
    assert beside.states[1] > 0.95
    assert beside.width > 1.5 * without.width


def test_steps_as_long_as_gaps_tell_what_short_ones_do():
    """The trapezoidal rule would be off by 13 % of what the parameters do."""
    truth = trajectories(dataclasses.replace(SPRING, steps=1600), 20, 3)
    gap = 80
    sensor = Sensor(SPRING.space, measured="position", noise=NOISE, every=gap)
    segment = whole(sensor.measure(truth, 0), sensor.instrument(SPRING.dt))
    learned = Learned(SPRING.stiffness)
    long, short = (
        forecast(learned, segment._replace(instrument=segment.instrument._replace(longest=step)), known(0.05))
        for step in (gap * SPRING.dt, gap * SPRING.dt / 16)
    )
    assert long is not None
    assert short is not None
    assert 0.2 < short.parameters < 0.8
    assert long.parameters == pytest.approx(short.parameters, rel=0.02)
    assert long.width == pytest.approx(short.width, rel=0.02)


@pytest.mark.parametrize("robust", ["huber", "student"])
def test_outliers_are_left_out_where_the_training_weighed_them_down(robust):
    truth = trajectories(LONG, 60, 3)
    segment = measured(truth, outliers=0.05)
    found = forecast(Learned(LONG.stiffness), segment, known(1e-9), robust, truth)
    assert found is not None
    assert found.trajectories > 50
    assert found.coverage == pytest.approx((0.6827, 0.9545, 0.9973), abs=0.03)


def test_true_states_ahead_count_alone():
    truth = trajectories(SPRING, 3, 1)
    states = truth.states.clone()
    states[:, : states.shape[1] // 2 - EVERY] += 1e3
    segment = measured(truth)
    found, beside = (
        forecast(Learned(), segment, known(0.1), truth=t) for t in (truth, truth._replace(states=states))
    )
    assert found == beside


def test_what_cannot_be_fitted_is_not_forecast():
    segment = measured(trajectories(SPRING, 3, 1))
    lost = segment._replace(values=1e3 * torch.randn(segment.values.shape, generator=generator(0), **DOUBLE))
    assert forecast(Learned(), lost, known(0.1)) is None
    values = torch.full_like(segment.values, torch.nan)
    values[:, 0] = segment.values[:, 0]
    assert forecast(Learned(), segment._replace(values=values), known(0.1)) is None


def test_trajectories_are_forecast_as_each_would_be_alone(monkeypatch):
    """One that nothing fits, one that ends early, two with gaps, one that begins later."""
    monkeypatch.setattr(bands, "CELLS", 1)  # one path at a time
    truth = trajectories(SPRING, 5, 1)
    segment = measured(truth, kind="state")
    values = segment.values.clone()
    values[0] += 1e3 * torch.randn(values[0].shape, generator=generator(0), **DOUBLE)
    values[1, 20:] = torch.nan
    values[2, 18:22] = torch.nan
    values[3, ::3, 0] = torch.nan
    values[4, :5] = torch.nan
    segment = segment._replace(values=values)
    times = truth.times.clone()
    times[1, 80:] = torch.nan
    states = truth.states.masked_fill(times.isnan().unsqueeze(-1), torch.nan)
    truth = Trajectories(states, times)

    found = forecast(Learned(), segment, known(0.05), truth=truth)
    assert found is not None
    assert found.states is not None
    assert (found.lost, found.trajectories) == (1, 5)
    assert "; first halves not fitted: 1" in found.sentence()
    shares, of_states = torch.zeros(3, **DOUBLE), torch.zeros(3, **DOUBLE)
    numbers = components = 0
    for k in range(1, 5):
        one = segment.rows(slice(k, k + 1))
        alone = forecast(
            Learned(), one, known(0.05), truth=Trajectories(truth.states[k : k + 1], truth.times[k : k + 1])
        )
        assert alone is not None
        assert alone.states is not None
        later = ~first_part(one, 0.5)
        count = int((later.unsqueeze(-1) & ~one.values.isnan()).sum())
        shares, numbers = shares + count * torch.tensor(alone.coverage, **DOUBLE), numbers + count
        there = 2 * int((later & ((k != 1) | (one.times < 0.795))).sum())
        of_states, components = of_states + there * torch.tensor(alone.states, **DOUBLE), components + there
    close(torch.tensor(found.coverage, **DOUBLE), shares / numbers, 1e-9)
    close(torch.tensor(found.states, **DOUBLE), of_states / components, 1e-9)
    assert 0.2 < found.coverage[0] < 0.95


class Escaping(Learned):
    """q'' = q^3 by RK4: what is not near zero leaves for infinity after a while."""

    def __init__(self):
        super().__init__()
        self.field = Cubic()


class Cubic(nn.Module):
    """The field; its factor is learned."""

    def __init__(self):
        super().__init__()
        self.factor = nn.Parameter(torch.ones(1, **DOUBLE))

    def forward(self, x):
        q, p = x.chunk(2, dim=-1)
        return torch.cat((p / SPRING.mass, self.factor * q**3), dim=-1)


def test_what_happens_beyond_the_end_of_a_trajectory_does_not_count():
    dt, samples = 0.05, 400
    start = torch.tensor([[1.0, 0.5], [0.01, 0.0], [1.2, 0.5]], **DOUBLE)
    learned = Escaping()
    with torch.no_grad():
        states = rollout(learned, start, dt, samples)
    assert not bool(states[0].isfinite().all())
    times = (dt * torch.arange(samples, **DOUBLE)).expand(3, -1)
    values = states[..., :1] + NOISE * torch.randn(3, samples, 1, generator=generator(1), **DOUBLE)
    values[[0, 2], 30:] = torch.nan
    instrument = measured(trajectories(SPRING, 3, 1)).instrument._replace(longest=dt)
    segment = Segment(values, times, instrument)
    found = forecast(learned, segment, known(1e-9))
    short = forecast(learned, segment.rows(torch.tensor([True, False, True])).first(29), known(1e-9))
    assert found is not None
    assert short is not None
    assert (found.lost, short.lost) == (0, 0)
    assert found.coverage[1] > 0.9
    assert short.coverage[1] > 0.8


def test_small_units_are_no_small_numbers():
    """A spring whose numbers are 1e-21 of those of another has the same shares."""
    learned, truth = Learned(), trajectories(SPRING, 20, 1)
    segment = measured(truth, kind="state")
    small = segment._replace(
        values=1e-21 * segment.values,
        instrument=segment.instrument._replace(deviations=1e-21 * segment.instrument.deviations),
    )
    found = forecast(learned, segment, known(0.1), truth=truth)
    tiny = forecast(learned, small, known(0.1), truth=truth._replace(states=1e-21 * truth.states))
    assert found is not None
    assert tiny is not None
    assert found.states is not None
    assert tiny.coverage == pytest.approx(found.coverage, abs=0.005)
    assert tiny.states == pytest.approx(found.states, abs=0.005)


def test_a_robust_check_says_what_it_leaves_out():
    truth = trajectories(LONG, 60, 3)
    wrong, segment = Learned(LONG.stiffness + 2.0), measured(truth)
    plain, robust = (forecast(wrong, segment, known(1e-9), name) for name in ("none", "huber"))
    assert plain is not None
    assert robust is not None
    assert plain.coverage[1] < 0.6
    right = forecast(Learned(LONG.stiffness), segment, known(1e-9), "huber")
    assert right is not None
    assert right.outliers < 1e-3 < robust.outliers
    assert "% excluded as outliers" in robust.sentence()


def test_states_at_times_are_exact_and_there_are_none_beyond_the_end():
    times = torch.tensor([[0.0, 0.1, 0.5, 0.6], [1.0, 1.3, 1.4, 2.0]], **DOUBLE)
    truth = Trajectories(torch.arange(8, **DOUBLE).reshape(2, 4, 1), times)
    wanted = torch.tensor([[1.3 + 1e-9, 2.0, 2.6, 1.2]], **DOUBLE)
    found = at(truth, torch.tensor([False, True]), wanted)
    assert found[0, :2, 0].tolist() == [5.0, 7.0]
    assert bool(found[0, 2:].isnan().all())


def test_an_evaluation_tells_what_forecasts_hold(tmp_path):
    truth = trajectories(SPRING, 3, 1)
    uncertainty = Uncertainty(known(0.1), torch.zeros(1, **DOUBLE), 1.0, {"determined": 1.0})
    case = make_case(tmp_path, flow=Learned(), test=truth, measured=measured(truth), uncertainty=uncertainty)
    findings = evaluate(case, {}, figures=False)
    told = findings.rows[0].note.splitlines()
    assert [line.split()[0] for line in told] == ["relative", "residuals", "bands", "forecasts"]
    assert "true states" in findings.rows[0].note
    assert findings.numbers["forecast"]["trajectories"] == 3
    bare = evaluate(dataclasses.replace(case, uncertainty=None), {}, figures=False)
    assert "forecast" not in bare.numbers
    own = dataclasses.replace(case, truth=None, fitted=truth.states[:, 0])
    assert evaluate(own, {}, figures=False).numbers["forecast"]["states"] is None
