"""Trajectories that a user brings: what passes, and what is refused with what came."""

from __future__ import annotations

import math
from contextlib import nullcontext

import numpy as np
import pytest
import torch

from ahnn.data.in_memory import check_trajectories, content_of
from ahnn.data.sources import Given
from ahnn.errors import UserError
from ahnn.stored import about_space
from ahnn.types import Space, Trajectories, Units

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


def test_numbers_that_are_missing_stay_missing_and_trajectories_begin_where_they_do():
    """The first whole sample is the second of the first trajectory; the second one lacks its last time."""
    states, times = STATES.clone(), TIMES.clone()
    states[0, 0, 3] = states[0, 1, 0] = times[1, 2] = torch.nan
    states[0, 1, 0] = 4.0
    got = Given(Trajectories(states, times), SPACE).read()
    assert got.times.tolist() == [[1.0, 2.5], [1.0, 4.0]]
    assert torch.equal(got.states[0], states[0, 1:].double())
    assert torch.equal(got.states[1], STATES[1, :2].double())
    assert Given(Trajectories(states, times), SPACE).steps() == 1
    assert Given(Trajectories(STATES, TIMES), SPACE).steps() == 2


@pytest.mark.parametrize("states", [STATES[..., :2], STATES.index_fill(2, torch.tensor([2, 3]), torch.nan)])
def test_positions_alone_are_columns_that_are_left_out_or_nan(states):
    source = Given(Trajectories(states, TIMES), SPACE)
    assert source.positions_only
    assert torch.equal(source.read().states[..., :2], STATES[..., :2].double())
    assert bool(source.read().states[..., 2:].isnan().all())


def test_numbers_are_used_up_to_those_whose_squares_are_infinite():
    space, largest = Space("driven", ("q", "p"), controls=("u",)), 1e150
    for value, refused in ((largest, False), (math.nextafter(largest, math.inf), True)):
        for sign in (1, -1):
            states = torch.zeros(1, 2, 2, dtype=torch.float64).index_fill(1, torch.tensor(1), sign * value)
            times = torch.tensor([[0.0, value]], dtype=torch.float64)
            zeros = torch.zeros(1, 2, 1, dtype=torch.float64)
            for who, part in (
                ("states", Trajectories(states, torch.arange(2.0))),
                ("times", Trajectories(torch.zeros(1, 2, 2), sign * times.flip(1) if sign < 0 else times)),
                ("controls", Trajectories(torch.zeros(1, 2, 2), torch.arange(2.0), zeros + sign * value)),
            ):
                given = part if who == "controls" else part._replace(controls=zeros)
                with pytest.raises(UserError, match=who) if refused else nullcontext():
                    content_of(given, space)


def test_a_step_ten_times_as_long_as_most_is_a_gap():
    """Of times on no grid: a shorter one is a step, and a longer one has samples that are missing."""
    for length, gap in ((9.6, False), (11.4, True)):
        steps = torch.tensor([[1.0, 1.05, 0.95, length, 1.0, 0.9, 1.1, 1.0]], dtype=torch.float64)
        times = torch.nn.functional.pad(steps.cumsum(1), (1, 0))
        states = torch.arange(36.0, dtype=torch.float64).reshape(1, 9, 4)
        found = Given(Trajectories(states, times), SPACE).read()
        assert found.states.shape[1] == (9 + 10 if gap else 9)
        assert int(found.states.isnan().all(-1).sum()) == (10 if gap else 0)


def test_one_trajectory_of_one_sample_passes():
    assert checked(STATES[:1, :1], TIMES[:1, :1]).states.shape == (1, 1, 4)
    pair = checked(STATES[..., :2], space=Space("pair", ("q", "p")))
    assert pair.states.shape == (2, 3, 2)


BAD = [0, -1.0, torch.nan, torch.inf, "2", None, True, [1.0]]
"""What is no mass."""


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
        ({"states": STATES[0]}, r"\(trajectories, samples, 4\), the components x, y, px, py; received"),
        ({"states": STATES[..., :3]}, r"received \(2, 3, 3\)"),
        ({"states": [*STATES.tolist(), [[1.0]]]}, "states: expected numbers in"),
        ({"states": STATES > 3}, "received Tensor of torch.bool"),
        ({"states": STATES[:0], "times": TIMES[:0]}, r"states: expected shape .* received \(0, 3, 4\)"),
        ({"states": STATES[:, :0], "times": TIMES[:, :0]}, r"received \(2, 0, 4\)"),
        (
            {"times": TIMES[:, :2]},
            r"expected shape \(2, 3\), or \(3,\) for all trajectories; received \(2, 2\)",
        ),
        ({"times": TIMES[:1]}, r"received \(1, 3\)"),
        ({"times": TIMES[:, 0]}, r"received \(2,\)"),
        ({"states": changed((0, 0, 0), torch.inf, STATES)}, "expected a finite number"),
        ({"times": changed((1, 2), torch.inf)}, "expected a finite number"),
        ({"times": changed((1, 2), 4.0)}, r"received \[4.0, 4.0\] from sample 1 of trajectory 1"),
        ({"times": changed((0, 1), -1.0)}, r"received \[0.0, -1.0\] from sample 0 of trajectory 0"),
        ({"times": changed((0, 1), torch.nan)}, "received NaN before a time"),
        ({"times": changed((0, 0), torch.nan)}, "received NaN before a time"),
        ({"space": "mine"}, r"space: expected ahnn.Space\(name, components\); received str"),
        ({"space": SPACE._replace(components=("x", "y", "x", "py"))}, "different names; received 'x' twice"),
        ({"space": SPACE._replace(components=("x", "", "px", "py"))}, "printable names.*received ''"),
        ({"space": SPACE._replace(components="xyuv")}, "components: expected a list of str"),
        ({"space": SPACE._replace(name="a\nb")}, "printable names"),
        ({"space": SPACE._replace(name="${oc.env:HOME}")}, "without \\$"),
        ({"space": SPACE._replace(units=("s", "m"))}, r"space.units: expected ahnn.Units\(...\)"),
        (
            {"space": SPACE._replace(units=Units(position=3))},
            "space.units.position: expected str; received 3",
        ),
        *(({"space": SPACE._replace(inertia=bad)}, "space.inertia: expected") for bad in BAD),
    ],
)
def test_what_does_not_fit_is_refused_with_what_came(change, message):
    with pytest.raises(UserError, match=message):
        checked(**change)


@pytest.mark.parametrize("components", [(), ("q",), ("q", "p", "r")])
def test_components_that_are_no_pairs_have_no_degrees_of_freedom(components):
    for name in ("dof", "scales", "angular"):
        with pytest.raises(UserError, match=f"expected 2n components.*received {len(components)}"):
            getattr(Space("odd", components), name)


def test_no_whole_sample_is_no_trajectory():
    states = STATES.clone()
    states[1, :, 2] = torch.nan
    with pytest.raises(UserError, match="trajectory 1, row 1: expected a trajectory with a complete sample"):
        Given(Trajectories(states, TIMES), SPACE)


def test_what_is_no_pair_of_states_and_times_is_named():
    with pytest.raises(UserError, match=r"expected ahnn.Trajectories\(states, times\); received tuple"):
        check_trajectories((STATES, TIMES), SPACE)  # pyright: ignore[reportArgumentType]


def test_the_same_trajectory_twice_is_refused_unless_it_is_asked_for():
    states, times = torch.rand(2, 9, 4), torch.arange(9.0)
    states[1] = states[0]
    given = Trajectories(states, times)
    with pytest.raises(
        UserError, match=r"trajectory 1, row 1: expected valid data.*the samples from row 1 of trajec"
    ):
        Given(given, SPACE).check()
    Given(given, SPACE, unsound=True).check()


def test_a_part_of_trajectories_with_common_times_keeps_all_times():
    data = Trajectories(torch.ones(3, 4, 2), torch.arange(4.0))
    part = data.part(slice(0, 2))
    assert part.states.shape == (2, 4, 2)
    assert torch.equal(part.times, data.times)


def test_masses_may_be_numbers_of_numpy():
    about = about_space(SPACE._replace(inertia=np.float64(1.5)))
    assert type(about["inertia"]) is float
    about = about_space(Space("two", ("x", "y", "p", "r"), inertia=tuple(np.array([1.0, 2.0]))))
    assert [type(one) for one in about["inertia"]] == [float, float]
