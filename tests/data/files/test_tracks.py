"""Rows as trajectories: gaps on a grid and off it, cuts, and ids in the order of the file."""

from __future__ import annotations

import numpy as np
import pytest

from ahnn.data.files.samples import Track, by_id, cut, filled, ordered, stacked, trimmed
from ahnn.data.files.table import Fault


def track(times, first=2, name="a"):
    times = np.asarray(times, dtype=float)
    values = np.stack((10.0 * times, -times), axis=1)
    return Track(name, "a.csv", first + np.arange(len(times)), times, values)


def absent(found):
    return np.flatnonzero(np.isnan(found.values).all(1)).tolist()


def test_a_point_of_a_grid_that_is_missing_is_a_gap():
    found = filled(track([0, 1, 2, 4, 5, 9, 10, 11, 12]), 10.0)
    assert found.times.tolist() == list(range(13))
    assert absent(found) == [3, 6, 7, 8]
    assert found.rows.tolist() == [2, 3, 4, 0, 5, 6, 0, 0, 0, 7, 8, 9, 10]
    assert found.values[9].tolist() == [90.0, -9.0]


def test_a_grid_may_be_off_by_half_a_percent_and_by_two_it_is_none():
    for share, gone in ((0.005, [3]), (0.02, [])):
        times = np.array([0, 1, 2, 4, 5, 6, 7, 8.0])
        times[5] += share
        assert absent(filled(track(times), 10.0)) == gone


def test_off_a_grid_only_a_long_step_is_a_gap():
    times = np.cumsum([0, 1, 1.3, 0.8, 1.1, 6.4, 0.9, 1.2, 0.7, 1.0])
    assert absent(filled(track(times), 7.0)) == []
    found = filled(track(times), 5.0)
    assert absent(found) == [5, 6, 7, 8, 9]
    assert np.diff(found.times)[4:10] == pytest.approx(np.full(6, 6.4 / 6), rel=1e-12)


@pytest.mark.parametrize(("gap", "fits"), [(190, True), (205, False)])
def test_twenty_absent_samples_for_each_that_is_there_separate_two_trajectories(gap, fits):
    times = [0, 1, 2, 3, 4, *(4 + gap + np.arange(5))]
    if fits:
        assert len(filled(track(times), 10.0).times) == times[-1] + 1
        return
    with pytest.raises(Fault, match=r"row 7: expected gaps with at most 20 .* received one of 205 steps"):
        filled(track(times), 10.0)


def test_two_samples_have_no_step_that_is_usual():
    assert filled(track([0, 7]), 2.0).times.tolist() == [0, 7]
    assert filled(track([0, 1, 3]), 2.0).times.tolist() == [0, 1, 3]
    assert filled(track([0, 1, 2, 4]), 2.0).times.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("samples", "sizes"), [(None, [10]), (4, [5, 5]), (3, [4, 3, 3]), (99, [10]), (7, [10])]
)
def test_segments_are_about_as_long_as_asked_for(samples, sizes):
    parts = cut(track(range(10)), samples)
    assert [len(part.times) for part in parts] == sizes
    assert np.concatenate([part.rows for part in parts]).tolist() == list(range(2, 12))


def test_ends_without_a_whole_sample_are_left_out():
    given = track(range(6))
    given.values[0, 1] = given.values[3, 0] = given.values[5, 1] = np.nan
    assert trimmed(given).times.tolist() == [1, 2, 3, 4]
    given.values[:] = np.nan
    assert len(trimmed(given).times) == 0


def test_ids_keep_the_order_of_the_file():
    parts = by_id(["b", "a", "b", "c", "a"], track(range(5)))
    assert [(part.name, part.rows.tolist()) for part in parts] == [("b", [2, 4]), ("a", [3, 6]), ("c", [5])]


def test_times_that_do_not_increase_are_named_with_the_last_that_did():
    faults = []
    found = ordered(track([0, 2, np.nan, 1, 2, 3, 3, 4]), "t", faults.append)
    assert found.times.tolist() == [0, 2, 3, 4]
    assert [(fault.place.row, fault.expected, fault.received) for fault in faults] == [
        (4, "a time", "none"),
        (5, "a time of a after 2.0 in row 3", "1.0"),
        (6, "each time of a once", "2.0, which duplicates row 3"),
        (8, "each time of a once", "3.0, which duplicates row 7"),
    ]
    assert len(ordered(track([]), "t").times) == 0


def test_times_that_restart_are_one_fault():
    faults = []
    found = ordered(track([0, 1, 2, 0.1, 1, 2, 3, 0, 1, 2]), "t", faults.append)
    assert found.times.tolist() == [0, 1, 2]
    ((place, expected, received, remedy),) = [(f.place, f.expected, f.received, f.remedy) for f in faults]
    assert (place.row, place.column, expected) == (5, "t", "increasing times of a")
    assert received == "a restart at 0.1 after 2.0, and 1 more"
    assert "a separate id" in remedy
    faults.clear()
    ordered(track([0, 1, 2, 0, 1, 2, 1]), "t", faults.append)  # the last is out of order
    assert [fault.place.row for fault in faults] == [5, 6, 7, 8]
    faults.clear()
    ordered(track([0, 1, 2, 0]), "t", faults.append)  # one wrong time
    assert [fault.expected for fault in faults] == ["a time of a after 2.0 in row 4"]


def test_shorter_trajectories_end_with_nothing():
    states, times, *_ = stacked([track([0, 1, 2]), track([5])])
    assert states.shape == (2, 3, 2)
    assert times[1, 0] == 5
    assert bool(times[1, 1:].isnan().all())
    assert bool(states[1, 1:].isnan().all())
    assert states[0, 2].tolist() == [20.0, -2.0]
