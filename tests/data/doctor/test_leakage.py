"""Samples that two trajectories share, number for number: how many there must be, and which count."""

from __future__ import annotations

import numpy as np
import pytest

from ahnn.data.doctor.leakage import leakage_findings, runs
from ahnn.data.files.samples import Track


def track(values, name="a", first=2):
    values = np.asarray(values, dtype=float)
    return Track(name, f"{name}.csv", first + np.arange(len(values)), 0.1 * np.arange(len(values)), values)


def drawn(count, seed):
    return np.random.default_rng(seed).standard_normal((count, 2))


def found(*tracks):
    return [(one.file, one.row, one.what.partition("row ")[2]) for one in leakage_findings([*tracks])]


@pytest.mark.parametrize(("count", "leak"), [(7, False), (8, True), (12, True)])
def test_eight_samples_in_a_row_are_no_chance(count, leak):
    one, other = drawn(40, 0), drawn(30, 1)
    other[5 : 5 + count] = one[20 : 20 + count]
    expected = [("b.csv", 107, "22 of a.csv of trajectory a")] if leak else []
    assert found(track(one), track(other, "b", 102)) == expected


@pytest.mark.parametrize(("count", "leak"), [(2, False), (3, True), (7, True)])
def test_whole_trajectories_may_be_shorter_than_that(count, leak):
    values = drawn(count, 2)
    expected = [("b.csv", 2, "2 of a.csv of trajectory a")] if leak else []
    assert found(track(values), track(values, "b")) == expected
    assert found(track(values), track(values + 1e-12, "b")) == []
    assert found(track(values), track(values[::-1], "b")) == []
    assert found(track(values), track(values[:, ::-1], "b")) == []


def test_each_pair_is_named_once_by_where_it_begins():
    values = drawn(40, 3)
    three = [track(values), track(values[10:], "b"), track(np.vstack((drawn(4, 4), values[20:])), "c")]
    assert found(*three) == [
        ("b.csv", 2, "12 of a.csv of trajectory a"),
        ("c.csv", 6, "12 of b.csv of trajectory b"),
    ]


def test_what_is_missing_or_does_not_change_is_no_copy_and_minus_zero_is_zero():
    values = drawn(20, 5)
    lost, rest = values.copy(), values.copy()
    lost[[4, 9, 14], 1] = np.nan
    assert found(track(lost), track(lost, "b")) == []
    rest[:] = values[0]
    assert found(track(rest), track(rest, "b")) == []
    rest[10] = values[1]
    assert (runs(track(rest)) != 0).tolist() == [3 <= k <= 10 for k in range(13)]
    values[3, 0], again = 0.0, values.copy()
    again[3, 0] = -0.0
    assert [row for _, row, _ in found(track(values), track(again, "b"))] == [2]


def test_a_trajectory_may_come_back_to_where_it_was():
    values = np.tile(drawn(9, 6), (3, 1))
    assert found(track(values)) == []
    assert found() == []
