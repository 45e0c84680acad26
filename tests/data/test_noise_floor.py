"""Noise that differences of high order show, against what was drawn."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import MOLNIYA, close, generator
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import comb
from scipy.stats import norm

from ahnn.data import noise_floor as room
from ahnn.data.generate import generate
from ahnn.data.noise_floor import (
    differences,
    differences_level,
    noise_floor,
    remark_on,
    weights,
    without_events,
)
from ahnn.types import Trajectories

ORBITS = generate(MOLNIYA, 12, 0)
NAMES = [f"c{k}" for k in range(6)]
UNITS = ["1"] * 6


def noisy(sd, truth=ORBITS, seed=3):
    draw = torch.randn(truth.states.shape, generator=generator(seed), dtype=torch.float64)
    return Trajectories(truth.states + draw * torch.as_tensor(sd, dtype=torch.float64), truth.times)


@pytest.mark.slow
@given(st.floats(-6, 1))
def test_the_noise_that_was_drawn_is_found(exponent):
    sd = 10.0**exponent * torch.tensor([1, 1, 1, 1e-3, 1e-3, 1e-3], dtype=torch.float64)
    close(noise_floor(*noisy(sd)[:2]), sd, 0.05)


def test_a_smooth_motion_has_no_noise_but_rounding():
    typical = ORBITS.states.diff(dim=1).abs().flatten(0, 1).median(0).values
    assert bool((noise_floor(*ORBITS[:2]).nan_to_num() < 1e-10 * typical).all())


@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e9])
def test_the_noise_of_swings_at_random_times_is_found_in_any_unit_of_time(unit):
    """Times as a clock that is read now and then has them: exponential waits, 25 a turn on average."""
    waits = -torch.rand(60, 200, generator=generator(7), dtype=torch.float64).log() * 0.25
    times = waits.cumsum(1)
    exact = torch.stack((times.cos(), -times.sin()), -1)
    sd = torch.tensor([1e-2, 3e-3], dtype=torch.float64)
    draw = torch.randn(exact.shape, generator=generator(8), dtype=torch.float64)
    close(noise_floor(exact + sd * draw, unit * times), sd, 0.05)
    off = torch.rand(exact.shape, generator=generator(9), dtype=torch.float64) < 0.03
    close(noise_floor(exact + sd * draw.where(~off, 50.0), unit * times), sd, 0.05)
    assert bool(noise_floor(exact, unit * times).isnan().all())


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_noise_alone_is_found_in_any_unit(size):
    draw = size * torch.randn(60, 100, 2, generator=generator(4), dtype=torch.float64)
    times = torch.arange(100.0, dtype=torch.float64).expand(60, -1)
    close(noise_floor(draw, times), torch.full((2,), size, dtype=torch.float64), 0.05)


@given(st.integers(1, 10), st.integers(0, 1000))
def test_weights_of_a_difference_are_the_unit_vectors_that_polynomials_of_lower_degree_vanish_in(order, seed):
    times = torch.rand(3, 15, generator=generator(seed), dtype=torch.float64).sort(1).values
    found = weights(times, order)
    close(found.norm(dim=-1), torch.ones(3, 15 - order), 1e-12)
    powers = torch.stack([(times - 0.5) ** k for k in range(order)], -1)
    assert float(differences(powers, found).abs().max()) < 1e-12


def test_some_of_many_trajectories_tell_the_noise(monkeypatch):
    seen = []
    monkeypatch.setattr(room, "LOOKED_AT", ORBITS.times.numel() // 3)
    monkeypatch.setattr(room, "noise_floor", lambda *samples: seen.append(samples) or noise_floor(*samples))
    assert "0.1" in str(remark_on(*noisy(0.1)[:2], NAMES, UNITS, None))
    assert len(seen[0][0]) == 4  # of 12, evenly chosen
    assert torch.equal(seen[0][1], ORBITS.times[::3])


@pytest.mark.parametrize(
    ("most", "rows", "samples"), [(9000, 3, 1441), (2000, 2, 1000), (500, 1, 500), (5, 1, 11)]
)
def test_the_beginnings_of_long_trajectories_tell_it(most, rows, samples, monkeypatch):
    monkeypatch.setattr(room, "LOOKED_AT", most)
    states, times = room.looked_at(*ORBITS.part(slice(3))[:2])
    assert times.shape == (rows, samples)
    assert torch.equal(states, ORBITS.states[: 3 : 2 if rows == 2 else 1][:rows, :samples])


def test_absent_samples_do_not_count():
    gone = torch.rand(ORBITS.times.shape, generator=generator(5)) < 0.05
    given = noisy(0.1)
    given.states[gone] = torch.nan
    close(noise_floor(*given[:2]), torch.full((6,), 0.1), 0.05)


@pytest.mark.parametrize(("share", "bound"), [(0.05, 0.05), (0.1, 0.1)])
def test_outliers_are_no_noise(share, bound):
    given = noisy(0.1)
    draw = torch.rand(given.states.shape, generator=generator(8))
    off = given.states + 50 * 0.1 * torch.where(draw < share / 2, -1.0, 1.0) * (draw < share)
    close(noise_floor(off, given.times), torch.full((6,), 0.1), bound)


def test_a_motion_that_is_sampled_too_rarely_tells_nothing():
    rare = Trajectories(ORBITS.states[:, ::60], ORBITS.times[:, ::60])
    assert bool(noise_floor(*rare[:2]).isnan().any())
    short = Trajectories(ORBITS.states[:, :9], ORBITS.times[:, :9])
    assert bool(noise_floor(*short[:2]).isnan().all())


@pytest.mark.parametrize(
    ("stated", "said"), [(0.1, None), (0.3, "data.noise differs"), (0.03, "deviations of c0 0.")]
)
def test_noise_is_remarked_upon_where_it_matters(stated, said):
    remark = remark_on(*noisy(0.1)[:2], NAMES, UNITS, torch.full((6,), stated, dtype=torch.float64))
    assert remark is None if said is None else said in remark


def test_a_loss_that_takes_noisy_samples_as_exact_is_warned_of():
    assert "recipe=measurements" in (remark_on(*noisy(0.1)[:2], NAMES, UNITS, None) or "")
    assert remark_on(*ORBITS[:2], NAMES, UNITS, None) is None


@pytest.mark.parametrize(("count", "told"), [(10, False), (11, True)])
def test_a_difference_of_tenth_order_takes_eleven_samples(count, told):
    draw = torch.randn(400, count, 2, generator=generator(4), dtype=torch.float64)
    found = noise_floor(draw, torch.arange(count, dtype=torch.float64).expand(400, -1))
    assert bool(found.isfinite().all()) == told
    assert not told or float((found - 1).abs().max()) < 0.15


@pytest.mark.parametrize(("factor", "told"), [(1.01, True), (0.99, False)])
def test_noise_is_what_differences_of_the_next_orders_find_again_to_a_fifth(factor, told):
    """Differences of a wave grow by 2 sin(w/2) with each order, and those of noise by (4 - 2/k)^(1/2)."""
    sine = 0.8 * math.sqrt(3.8) / 2 * factor  # of w/2: from the ninth to the tenth the level falls by a fifth
    phases = torch.arange(400, dtype=torch.float64).unsqueeze(-1) * math.pi / 400
    times = torch.arange(40, dtype=torch.float64).expand(400, -1)
    waves = (2 * math.asin(sine) * times + phases).cos().unsqueeze(-1)
    (found,) = differences_level(waves, times).tolist()
    assert bool(noise_floor(waves, times).isnan())
    expected = (2 * sine) ** 8 * math.cos(math.pi / 4) / norm.ppf(0.75) / math.sqrt(comb(16, 8))
    assert found == (pytest.approx(expected, rel=0.01) if told else pytest.approx(math.nan, nan_ok=True))


def test_an_event_is_six_deviations_away_by_the_fifth_of_the_differences_that_is_smallest():
    """The eighth difference of +1, -1, +1 ... is 256, and a single sample counts 70 times where it stands."""
    clock = torch.arange(41, dtype=torch.float64)
    sign = 1.0 - 2 * (clock % 2)
    edge = (6 * 256 / norm.ppf(0.6) - 256) / 70
    for height, gone in ((0.99 * edge, []), (1.01 * edge, [20]), (1.01 * 70 / 56 * edge, [19, 20, 21])):
        samples = sign.repeat(60, 1).unsqueeze(-1)
        samples[3, 20] += height * sign[20]
        lost = without_events(samples, clock.expand(60, -1)).isnan()
        assert lost[3].flatten().nonzero().flatten().tolist() == gone
        assert int(lost.sum()) == len(gone)
    for quiet, seen in ((19, False), (21, True)):
        samples = torch.where(torch.arange(100) < quiet, 0.01, 1.0).view(100, 1, 1) * sign.view(1, -1, 1)
        lost = without_events(samples, clock.expand(100, -1))[:, 4:-4].isnan()
        assert bool(lost[quiet:].all()) == bool(lost.any()) == seen


@pytest.mark.parametrize(("stated", "said"), [(1.99, False), (2.01, True), (0.503, False), (0.497, True)])
def test_stated_noise_may_be_off_by_a_factor_of_two(stated, said):
    given = noisy(0.1)
    assert (remark_on(*given[:2], NAMES, UNITS, stated * noise_floor(*given[:2])) is not None) == said


@pytest.mark.parametrize(("times", "said"), [(0.99, False), (1.01, True)])
def test_noise_matters_from_a_ten_thousandth_of_the_usual_step_on(times, said):
    """A straight line has no differences of high order: its noise alone says how steep it may be."""
    clock = torch.arange(301, dtype=torch.float64).expand(20, -1)
    draw = torch.randn(20, 301, 2, generator=generator(6), dtype=torch.float64)
    still = draw.clone()
    still[..., 1] = draw[..., 1].gt(1.2)  # a switch that is mostly left as it is
    level = float(noise_floor(draw, clock)[0])
    still[..., 0] += level / 1e-4 / times * clock
    remark = remark_on(still, clock, ["line", "switch"], ["rad", "1"], None)
    assert (remark is not None) == said
    assert remark is None or f"deviations of line {level:.2g} rad," in remark


def test_the_noise_of_wide_swings_sampled_twenty_times_a_period_is_found():
    """The third harmonic is sampled twice in means of three samples, which are then more than noise."""
    count, sd = 30, 0.02
    phase = 0.31 * torch.arange(61, dtype=torch.float64).expand(count, -1)
    amplitude = 0.3 + 1.5 * torch.rand(count, 1, generator=generator(5), dtype=torch.float64)
    swings = amplitude * (phase.cos() + 0.02 * amplitude**2 * (3 * phase).cos())
    draw = torch.randn(swings.shape, generator=generator(6), dtype=torch.float64)
    close(noise_floor((swings + sd * draw).unsqueeze(-1), phase), torch.tensor([sd]), 0.1)
    assert bool(noise_floor(swings.unsqueeze(-1), phase).isnan().all())
