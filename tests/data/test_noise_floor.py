"""Noise that differences of high order show, against what was drawn."""

from __future__ import annotations

import pytest
import torch
from helpers import MOLNIYA, close, generator
from hypothesis import given
from hypothesis import strategies as st

from ahnn.data import noise_floor as room
from ahnn.data.generate import generate
from ahnn.data.noise_floor import noise_floor, remark_on
from ahnn.types import Trajectories

ORBITS = generate(MOLNIYA, 12, 0)
NAMES = [f"c{k}" for k in range(6)]


def noisy(sd, truth=ORBITS, seed=3):
    draw = torch.randn(truth.states.shape, generator=generator(seed), dtype=torch.float64)
    return Trajectories(truth.states + draw * torch.as_tensor(sd, dtype=torch.float64), truth.times)


@given(st.floats(-6, 1))
def test_the_noise_that_was_drawn_is_found(exponent):
    sd = 10.0**exponent * torch.tensor([1, 1, 1, 1e-3, 1e-3, 1e-3], dtype=torch.float64)
    close(noise_floor(noisy(sd)), sd, 0.05)


def test_a_smooth_motion_has_no_noise_but_rounding():
    typical = ORBITS.states.diff(dim=1).abs().flatten(0, 1).median(0).values
    assert bool((noise_floor(ORBITS).nan_to_num() < 1e-10 * typical).all())


def test_nothing_is_said_of_samples_at_unequal_steps():
    given = noisy(0.1)
    assert remark_on(given, NAMES, None) is not None
    uneven = given.times + 1e-3 * torch.rand(given.times.shape, generator=generator(7), dtype=torch.float64)
    assert remark_on(Trajectories(given.states, uneven), NAMES, None) is None


def test_some_of_many_trajectories_tell_the_noise(monkeypatch):
    seen = []
    monkeypatch.setattr(room, "LOOKED_AT", ORBITS.times.numel() // 3)
    monkeypatch.setattr(room, "noise_floor", lambda samples: seen.append(samples) or noise_floor(samples))
    assert "0.1" in str(remark_on(noisy(0.1), NAMES, None))
    assert len(seen[0].states) == 4  # of 12, evenly chosen
    assert torch.equal(seen[0].times, ORBITS.times[::3])


def test_absent_samples_do_not_count():
    gone = torch.rand(ORBITS.times.shape, generator=generator(5)) < 0.05
    given = noisy(0.1)
    given.states[gone] = torch.nan
    close(noise_floor(given), torch.full((6,), 0.1), 0.05)


@pytest.mark.parametrize(("share", "bound"), [(0.05, 0.05), (0.1, 0.1)])
def test_outliers_are_no_noise(share, bound):
    given = noisy(0.1)
    draw = torch.rand(given.states.shape, generator=generator(8))
    off = given.states + 50 * 0.1 * torch.where(draw < share / 2, -1.0, 1.0) * (draw < share)
    close(noise_floor(Trajectories(off, given.times)), torch.full((6,), 0.1), bound)


def test_a_motion_that_is_sampled_too_rarely_tells_nothing():
    rare = Trajectories(ORBITS.states[:, ::60], ORBITS.times[:, ::60])
    assert bool(noise_floor(rare).isnan().any())
    short = Trajectories(ORBITS.states[:, :9], ORBITS.times[:, :9])
    assert bool(noise_floor(short).isnan().all())


@pytest.mark.parametrize(
    ("stated", "said"), [(0.1, None), (0.3, "data.noise says otherwise"), (0.03, "noise of c0 0.")]
)
def test_noise_is_remarked_upon_where_it_matters(stated, said):
    remark = remark_on(noisy(0.1), NAMES, torch.full((6,), stated, dtype=torch.float64))
    assert remark is None if said is None else said in remark


def test_a_loss_that_takes_noisy_samples_as_exact_is_warned_of():
    assert "recipe=measurements" in (remark_on(noisy(0.1), NAMES, None) or "")
    assert remark_on(ORBITS, NAMES, None) is None


@pytest.mark.parametrize(("count", "told"), [(10, False), (11, True)])
def test_a_difference_of_tenth_order_takes_eleven_samples(count, told):
    draw = torch.randn(400, count, 2, generator=generator(4), dtype=torch.float64)
    found = noise_floor(Trajectories(draw, torch.arange(count, dtype=torch.float64).expand(400, -1)))
    assert bool(found.isfinite().all()) == told
    assert not told or float((found - 1).abs().max()) < 0.15
