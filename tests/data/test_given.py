"""Trajectories that a user brings: what passes, and what is refused with what came."""

from __future__ import annotations

import pytest
import torch

from ahnn.data.given import check_trajectories
from ahnn.data.sources import Given
from ahnn.errors import UserError
from ahnn.types import Space, Trajectories

SPACE = Space("mine", ("x", "y", "px", "py"))
STATES = torch.arange(24.0).reshape(2, 3, 4)
TIMES = torch.tensor([[0.0, 1.0, 2.5], [1.0, 4.0, 4.5]])


def checked(states=STATES, times=TIMES, space=SPACE):
    return check_trajectories(Trajectories(states, times), space)


def test_what_fits_passes_unchanged_in_float64():
    got = checked()
    assert got.states.dtype == got.times.dtype == torch.float64
    assert torch.equal(got.states, STATES.double())
    assert torch.equal(got.times, TIMES.double())
    lists = checked(STATES.tolist(), TIMES.tolist())
    assert torch.equal(lists.states, STATES.double())


def test_times_for_all_alike_become_those_of_each():
    got = checked(times=TIMES[1])
    assert torch.equal(got.times, TIMES[1].double().expand(2, 3))


def test_a_sample_with_any_nan_is_absent_as_a_whole():
    states, times = STATES.clone(), TIMES.clone()
    states[0, 1, 3] = times[1, 2] = torch.nan
    got = checked(states, times)
    assert got.present.tolist() == [[True, False, True], [True, True, False]]
    assert torch.equal(got.states.isnan().all(-1), ~got.present)
    assert torch.equal(got.states[got.present], states.double()[got.present])
    assert Given(Trajectories(states, times), SPACE).steps() == 1
    assert Given(Trajectories(STATES, TIMES), SPACE).steps() == 2


def test_one_trajectory_of_one_sample_passes():
    assert checked(STATES[:1, :1], TIMES[:1, :1]).states.shape == (1, 1, 4)
    pair = checked(STATES[..., :2], space=Space("pair", ("q", "p")))
    assert pair.states.shape == (2, 3, 2)


def changed(place, value, of=TIMES):
    copy = of.clone()
    copy[place] = value
    return copy


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"states": "none"}, "states: expected numbers"),
        ({"times": STATES[0, 0].to(torch.complex64)}, "times: expected real numbers"),
        ({"space": Space("odd", ("a", "b", "c"))}, "expected 2n components, positions first; received 3"),
        ({"space": Space("none", ())}, "expected 2n components, positions first; received 0"),
        ({"states": STATES[0]}, r"\(trajectories, samples, 4\) of x, y, px, py; received \(3, 4\)"),
        ({"states": STATES[..., :2]}, r"received \(2, 3, 2\)"),
        ({"states": STATES[:0], "times": TIMES[:0]}, r"states: expected shape .* received \(0, 3, 4\)"),
        ({"states": STATES[:, :0], "times": TIMES[:, :0]}, r"received \(2, 0, 4\)"),
        ({"times": TIMES[:, :2]}, r"expected shape \(2, 3\), or \(3,\) for all alike; received \(2, 2\)"),
        ({"times": TIMES[:1]}, r"received \(1, 3\)"),
        ({"times": TIMES[:, 0]}, r"received \(2,\)"),
        ({"states": changed((0, 0, 0), torch.inf, STATES)}, "expected finite numbers"),
        ({"times": changed((1, 2), torch.inf)}, "expected finite numbers"),
        ({"times": changed((1, 2), 4.0)}, r"received \[4.0, 4.0\] from sample 1 of trajectory 1"),
        ({"times": changed((0, 1), -1.0)}, r"received \[0.0, -1.0\] from sample 0 of trajectory 0"),
        ({"states": torch.full((2, 3, 4), torch.nan)}, "expected the first sample of each trajectory"),
    ],
)
def test_what_does_not_fit_is_refused_with_what_came(change, message):
    with pytest.raises(UserError, match=message):
        checked(**change)
