"""Single samples, columns and angles, at just less and just more than what the doctor lets pass."""

from __future__ import annotations

import re

import numpy as np
import pytest
import torch

from ahnn.data.doctor import examine
from ahnn.data.doctor.examine import diagnosis
from ahnn.data.doctor.samples import (
    gaps,
    missing,
    noise,
    runs_of_outliers,
    sample_findings,
    too_few,
    too_wide,
)
from ahnn.data.files.content import Column, Content
from ahnn.data.files.reading import FileReading
from ahnn.data.files.samples import Track
from ahnn.data.files.unwrapped_angles import turns_of
from ahnn.data.noise_floor import noise_floor
from ahnn.types import Units

TURN = 2 * np.pi


def track(values, times=None, name="a", first=2):
    values = np.asarray(values, dtype=float)
    values = values[:, None] if values.ndim == 1 else values
    times = 0.1 * np.arange(len(values)) if times is None else times
    return Track(name, "a.csv", first + np.arange(len(values)), times, values)


def content(*tracks, names=("q",), rates=(), units=("s", "rad")):
    return Content(names, rates, False, Units(*units), "", tracks, time="t", head=1)


def test_each_missing_number_is_named():
    values = np.arange(12.0).reshape(6, 2)
    values[1, 1] = values[4, 0] = np.nan
    found = [(one.level, one.row, one.column) for one in missing(track(values), ("x", "y"))]
    assert found == [("warning", 3, "y"), ("warning", 6, "x")]


def test_rates_missing_at_most_positions_are_one_finding():
    values = np.stack((np.arange(30.0), np.ones(30)), axis=1)
    values[np.arange(30) % 3 > 0, 1] = np.nan
    values[4, 0] = np.nan
    found = [
        one for one in sample_findings(content(track(values), rates=("v",)), 10.0) if "missing" in one.what
    ]
    assert [(one.level, one.row, one.column) for one in found] == [("warning", 1, "v"), ("warning", 6, "q")]
    assert found[0].what == "missing in 19 of 29 rows with positions"
    assert "leave out column v" in found[0].remedy


@pytest.mark.parametrize(("absent", "said"), [(1, "1 sample is missing"), (3, "3 samples are missing")])
def test_a_gap_says_how_many_are_missing_before_which_row(absent, said):
    times = np.cumsum([0.0, *[0.1] * 9, 0.1 * (absent + 1), *[0.1] * 9])
    (one,) = gaps(track(np.sin(times), times), "t", 10.0, "h")
    assert (one.level, one.row, one.column, one.what) == (
        "warning",
        12,
        "t",
        f"a gap of {6 * (absent + 1):.1f} min: {said} before this one",
    )


@pytest.mark.parametrize(
    ("jump", "typical", "seen"),
    [
        (TURN, 0.1, True),
        (TURN + 0.99, 0.1, True),
        (TURN - 0.99, 0.1, True),
        (TURN + 1.01, 0.1, False),
        (TURN - 1.01, 0.1, False),
        (TURN, TURN / 8.1, True),
        (TURN, TURN / 7.9, False),
    ],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_a_jump_is_about_a_turn_and_more_than_eight_usual_steps(jump, typical, seen, sign):
    steps = np.full(30, typical)
    steps[11] = jump
    found = turns_of(track(sign * np.cumsum(steps)), 1)[:, 0]
    assert np.flatnonzero(found).tolist() == ([11] if seen else [])
    assert found.sum() == sign * seen


@pytest.mark.parametrize(("there", "back", "seen"), [(6.3, 7.0, True), (7.0, 6.3, True), (6.2, 9.0, False)])
def test_angles_that_swing_to_and_fro_over_more_than_a_turn_are_warned_of_once(there, back, seen):
    """To `there` and `back`, of which the shorter way counts; who only turns may turn for ever."""
    swing = np.concatenate((np.linspace(0, there, 80), np.linspace(there, there - back, 80)[1:]))
    lost = swing.copy()
    lost[5] = np.nan
    turning, absent = track(np.linspace(0, 50, 400)), track(np.full(9, np.nan))
    found = list(too_wide(content(turning, absent, track(lost), track(swing))))
    said = f"oscillates over {max(there, back):.3g} rad, more than a turn"
    assert [(one.level, one.row, one.what) for one in found] == ([("warning", 1, said)] if seen else [])
    assert list(too_wide(content(turning))) == []


def test_lengths_may_jump_and_swing_as_they_like():
    steps = np.full(60, 0.1)
    steps[30] = TURN
    values = 30 * np.cos(np.cumsum(steps))
    assert list(sample_findings(content(track(values), units=("s", "m")), 10.0)) == []


@pytest.mark.parametrize(("first", "last"), [(20, 28), (0, 3), (47, 50)])
@pytest.mark.parametrize("factor", [1000.0, 1e5])
def test_several_values_of_another_unit_are_named_with_their_rows(first, last, factor):
    t, phases = 0.05 * np.arange(51), (0.3, 1.1, 2.0, 4.5)
    swings = [np.cos(2 * t + phase)[:, None] for phase in phases]
    assert not list(runs_of_outliers(content(*map(track, swings)), ("q",)))
    swings[2][first : last + 1] *= factor
    (found,) = runs_of_outliers(content(*map(track, swings)), ("q",))
    assert (found.level, found.row, found.column) == ("warning", first + 2, "q")
    assert f"{last - first + 1} successive values, rows {first + 2} to {last + 2}," in found.what


def test_a_trajectory_that_swings_much_wider_than_the_others_is_no_run_of_outliers():
    t = 0.05 * np.arange(51)
    swings = [size * np.cos(2 * t + size)[:, None] for size in (1e-3, 2e-3, 3e-3, 1.0)]
    assert not list(runs_of_outliers(content(*map(track, swings)), ("q",)))


def tensors(values):
    """States (1, T, 1) and times (1, T)."""
    states = torch.from_numpy(values).reshape(1, -1, 1)
    return states, 0.1 * torch.arange(len(values), dtype=torch.float64).unsqueeze(0)


@pytest.mark.parametrize(("times", "told"), [(0.99, False), (1.01, True)])
@pytest.mark.parametrize(("rates", "share"), [((), 1e-7), (("v",), 1e-4)])
def test_noise_is_told_from_a_share_of_the_usual_step_on(times, told, rates, share):
    """A straight line has no differences of high order: its noise alone says how steep it may be."""
    draw = np.random.default_rng(0).standard_normal(2001)
    level = float(noise_floor(*tensors(draw)))
    line = level / share / times * np.arange(2001)
    noisy = np.stack([line + draw] * (1 + len(rates)), axis=1)
    found = list(noise(content(track(noisy), units=("s", "m"), rates=rates), ("q", *rates), 10.0))
    assert [one.level for one in found] == ["note"] * (1 + len(rates)) * told
    assert all(one.what.startswith(f"noise of about {level:.2g}") for one in found)


def test_noise_takes_eleven_samples_at_any_steps():
    draw = np.random.default_rng(1).standard_normal((40, 11))
    even = [track(row, name=str(k)) for k, row in enumerate(draw)]
    assert [one.level for one in noise(content(*even), ("q",), 10.0)] == ["note"]
    assert list(noise(content(*(one.part(slice(10)) for one in even)), ("q",), 10.0)) == []
    times = np.cumsum(np.random.default_rng(2).uniform(0.5, 1.5, 11))
    (found,) = noise(content(*(one._replace(times=times) for one in even)), ("q",), 10.0)
    assert found.what == "noise of about 1 rad"
    (found,) = noise(content(*(one._replace(times=times) for one in even), units=("1", "1")), ("q",), 10.0)
    assert found.what == "noise of about 1"
    degrees = content(*(one._replace(times=times) for one in even))._replace(
        columns=(Column("q", "position", "deg"),)
    )
    (found,) = noise(degrees, ("q",), 10.0)
    assert re.fullmatch("noise of about (5[4-9]|60) deg, that is 1 rad", found.what)  # 57.3 deg


@pytest.mark.parametrize("count", [3, 200, 201, 401])
def test_units_are_judged_of_at_most_two_hundred_trajectories_evenly_spread(count, monkeypatch):
    seen = []
    room = diagnosis.__globals__
    monkeypatch.setitem(room, "velocity_findings", lambda *_: [])
    monkeypatch.setitem(room, "orbit_findings", lambda _, some: seen.extend(some) or [])
    empty = track(np.zeros((0, 1)))
    tracks = [track([k, 1.0, 4.0, 2.0], name=str(k)) for k in range(count)]
    assert diagnosis([content(empty, *tracks, empty)], None, 10.0) == []
    every = -(-count // 200)
    assert [int(one.name) for one in seen] == list(range(0, count, every))
    assert len(seen) <= 200


def test_files_of_other_columns_are_named_beside_the_first(tmp_path):
    t = 0.05 * np.arange(30)
    for name, unit in (("a", "m"), ("b", "km"), ("c", "m")):
        rows = "".join(f"{s},{ord(name) + np.cos(s)}\n" for s in t)
        (tmp_path / f"{name}.csv").write_text(f"t [s],x [{unit}]\n{rows}")
    found = examine([tmp_path / f"{name}.csv" for name in "abc"], FileReading()).findings
    assert [(one.level, one.file, one.row) for one in found] == [("fault", str(tmp_path / "b.csv"), 1)]
    assert found[0].what == f"expected the same units as in {tmp_path / 'a.csv'}; received different ones"


def test_a_gap_of_irregular_times_counts_no_samples():
    times = np.cumsum([0.1, 0.13, 0.08, 0.1, 0.11, 1.4, 0.09, 0.1, 0.12])
    (one,) = gaps(track(np.sin(times), times), "t", 10.0, "s")
    assert one.what == "a gap of 1.4 s: 13 times the median step before this sample"
    assert one.row == 7


def test_an_empty_column_of_rates_is_a_fault():
    values = np.stack((np.sin(np.arange(30.0)), np.full(30, np.nan)), axis=1)
    found = [*sample_findings(content(track(values), rates=("v",)), 10.0)]
    ((level, column, what, remedy),) = [
        (f.level, f.column, f.what, f.remedy) for f in found if f.column == "v"
    ]
    assert (level, column, what, remedy) == ("fault", "v", "an empty column", "Leave out column v")


@pytest.mark.parametrize(("rates", "said"), [((), "data.noise=0.0"), (("v",), "data.noise=estimate")])
def test_the_noise_that_is_found_is_an_option(rates, said):
    times, draw = 0.1 * np.arange(400), np.random.default_rng(0)
    values = np.stack((np.sin(times), np.cos(times)), axis=1)[:, : 1 + len(rates)]
    (found, *_) = noise(
        content(track(values + draw.normal(0, 0.02, values.shape), times), rates=rates), ("q", *rates), 10
    )
    assert found.remedy.startswith(f"Train with {said}")


@pytest.mark.parametrize(
    ("samples", "said"), [(59, "Give more"), (60, "system.cut=20"), (1440, "system.cut=144")]
)
def test_a_single_trajectory_is_to_be_cut_into_about_ten_if_it_is_long_enough(samples, said):
    file = content(track(np.sin(0.1 * np.arange(samples))))
    (one,) = too_few([file])
    assert one.level == "warning"
    assert said in one.remedy
    assert ("system.cut" in one.remedy) == (samples >= 60)
    assert not [*too_few([file, file])]
