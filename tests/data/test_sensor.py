"""Noise, gaps and outliers in place of states: their sizes, their seeds, and what is refused."""

from __future__ import annotations

import pytest
import torch
from helpers import MOLNIYA, SPRING, close
from scipy.stats import kstest

from ahnn.data.generate import generate
from ahnn.data.sensor import OUTLIER, Sensor
from ahnn.errors import UserError
from ahnn.measurements import GnssRange, GroundStation, Position, Several, State, noise_deviations
from ahnn.shooting.path_sensitivities import steps_between

TRUTH = generate(SPRING, 40, 0)
SPACE = SPRING.space


def sensor(**options):
    return Sensor(SPACE, **{"measured": "state", "noise": 0.01, **options})


def test_noise_has_its_standard_deviation_in_each_component():
    noisy = sensor(noise=[0.01, 0.5]).measure(TRUTH, 0)
    error = noisy.values - TRUTH.states
    sizes = error.flatten(0, 1).std(0)
    close(sizes, torch.tensor([0.01, 0.5]), 0.02)  # of 40,000 numbers
    assert torch.equal(noisy.times, TRUTH.times)


def test_heavy_tailed_noise_is_students_with_the_scale_of_the_noise():
    """40,000 numbers of each component by Kolmogorov and Smirnov, which normal noise would not pass."""
    options = {"noise": [0.01, 0.5], "gaps": 0.3}
    error = sensor(freedom=4.0, **options).measure(TRUTH, 0).values - TRUTH.states
    there = ~error.isnan()
    for k, scale in enumerate((0.01, 0.5)):
        values = (error[..., k][there[..., k]] / scale).numpy()
        assert kstest(values, "t", args=(4.0,)).pvalue > 1e-3
        assert kstest(values, "norm").pvalue < 1e-9
    assert torch.equal(there, ~sensor(**options).measure(TRUTH, 0).values.isnan())


def test_draws_belong_to_seed_and_part():
    first = sensor().measure(TRUTH, 0).values
    assert torch.equal(first, sensor().measure(TRUTH, 0).values)
    assert not torch.equal(first, sensor().measure(TRUTH, 1).values)
    assert not torch.equal(first, sensor(seed=1).measure(TRUTH, 0).values)


def test_positions_every_tenth_sample():
    seen = sensor(measured="position", every=10, noise=1e-9).measure(TRUTH, 0)
    assert seen.values.shape == (40, 101, 1)
    close(seen.values, TRUTH.states[:, ::10, :1], 1e-7)
    assert torch.equal(seen.times, TRUTH.times[:, ::10])


def test_a_stride_counts_the_samples_of_a_step():
    assert sensor(every=4, stride=3).instrument(0.1).longest == pytest.approx(0.3, rel=1e-12)


def test_gaps_take_whole_measurements_and_outliers_single_numbers():
    seen = sensor(gaps=0.3, outliers=0.05).measure(TRUTH, 0)
    missing = seen.values.isnan()
    assert torch.equal(missing[..., 0], missing[..., 1])
    assert 0.28 < float(missing.double().mean()) < 0.32
    off = (seen.values - TRUTH.states).abs() > 0.5 * OUTLIER * 0.01
    assert 0.045 < float(off[~missing].double().mean()) < 0.055
    assert float((off[..., 0] & off[..., 1]).double().mean()) < 0.005


def test_what_a_station_does_not_see_is_missing():
    orbits = generate(MOLNIYA, 2, 0)
    station = GroundStation(60.0, 30.0, min_elevation=10.0)
    seen = Sensor(MOLNIYA.space, measured=station, noise=[0.05, 1e-4, 1e-4]).measure(orbits, 0)
    visible = station.in_view(orbits.states, orbits.times)[..., 0]
    assert 0.1 < float(visible.double().mean()) < 0.9
    assert torch.equal(seen.values.isfinite().all(-1), visible)
    sightings = seen.values[visible]
    close(sightings[:, 0], station(orbits.states, orbits.times)[visible][:, 0], 1e-4)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"noise": 0.0}, "standard deviation > 0"),
        ({"noise": [0.1, 0.2, 0.3]}, "for each of q"),
        ({"noise": [0.1, float("nan")]}, "standard deviation > 0"),
        ({"measured": "velocity"}, "expected state, position or a model"),
        ({"measured": GnssRange([[1.0, 2.0, 3.0]])}, "locate"),
        ({"every": 0}, "every: expected"),
        ({"stride": 0}, "stride: expected"),
        ({"gaps": 1.0}, "gaps: expected"),
        ({"outliers": -0.1}, "outliers: expected"),
    ],
)
def test_what_makes_no_sensor_is_refused(options, said):
    with pytest.raises(UserError, match=said):
        sensor(**options)


def test_an_outlier_is_off_by_fifty_deviations_of_its_own_component_to_either_side():
    sizes = torch.tensor([0.01, 0.5])
    seen = sensor(noise=[0.01, 0.5], outliers=0.1).measure(TRUTH, 0)
    off = (seen.values - TRUTH.states) / sizes
    far = off.abs() > 10
    assert far.double().mean((0, 1)).tolist() == pytest.approx([0.1, 0.1], abs=0.01)
    assert float((off[far].abs() - 50).abs().max()) < 6  # the noise is still there
    assert float((off[far] > 0).double().mean()) == pytest.approx(0.5, abs=0.03)


def test_a_number_for_positions_and_one_for_momenta():
    found = Sensor(MOLNIYA.space, measured="state", noise=[0.1, 2e-4]).deviations
    assert found.tolist() == [0.1] * 3 + [2e-4] * 3
    single = Sensor(MOLNIYA.space, measured="state", noise=[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]).deviations
    assert single.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


def test_standard_deviations_of_one_of_several_of_a_kind_are_those_of_each():
    station = GroundStation(60.0, 30.0)
    two = Several([station, GroundStation(-30.0, 90.0)])
    assert noise_deviations(two, [0.05, 1e-4, 2e-4], "data.noise").tolist() == [0.05, 1e-4, 2e-4] * 2
    assert noise_deviations(two, 0.3, "data.noise").tolist() == [0.3] * 6
    six = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert noise_deviations(two, six, "data.noise").tolist() == six
    other = Several([station, Position(3), State(3)])
    for measurement, noise in ((two, [0.05, 1e-4]), (other, [1.0, 2.0, 3.0]), (station, [1.0, 2.0])):
        with pytest.raises(UserError, match="a standard deviation > 0 for each of"):
            noise_deviations(measurement, noise, "data.noise")


def test_tails_and_correlation_are_not_estimated_together():
    with pytest.raises(UserError, match=r"data.tails: expected data.correlation=null; received"):
        sensor(tails="estimate", correlation="estimate")


def test_steps_of_the_integrator_may_divide_the_interval_between_samples():
    instrument = sensor(stride=0.25).instrument(0.1)
    assert instrument.longest == pytest.approx(0.025)
    times = torch.tensor([[0.0, 0.1, 0.2, 0.5]], dtype=torch.float64)
    steps = steps_between(times, instrument.longest)
    assert steps.ends.tolist() == [0, 4, 8, 20]
    with pytest.raises(UserError, match="stride: expected float > 0"):
        sensor(stride=0)
