"""Stretches of measurements: where they begin, what lies in them, and how they are drawn."""

from __future__ import annotations

import pytest
import torch

from ahnn.data.loader import SegmentLoader
from ahnn.data.segments import Segments, ahead
from ahnn.errors import UserError
from ahnn.measurements import Instrument, Observations, Position

SEEN = Instrument(Position(1), torch.ones(1), 1.0, 1, 1.0)
NAN = float("nan")


def measured(rows=3, samples=12):
    values = torch.arange(float(rows * samples)).reshape(rows, samples, 1).double()
    return Observations(values, torch.arange(float(samples)).double().expand(rows, -1))


def test_all_segments_of_a_length():
    segments = Segments(measured(), 5, SEEN)
    assert len(segments) == 3 * 7
    batch = segments.gather(torch.tensor([0, 8, 20]))
    assert batch.values[..., 0].tolist() == [
        [0, 1, 2, 3, 4, 5],
        [13, 14, 15, 16, 17, 18],
        [30, 31, 32, 33, 34, 35],
    ]
    assert batch.times[1].tolist() == [1, 2, 3, 4, 5, 6]


def test_whole_trajectories_begin_where_a_start_can_be_guessed_and_end_unmeasured():
    data = measured()
    data.values[1, :2] = NAN
    data.values[2, 9:] = NAN
    times = data.times.clone()
    times[2, 9:] = NAN
    segments = Segments(Observations(data.values, times), None, SEEN)
    assert segments.begins.tolist() == [[0, 0], [1, 2], [2, 0]]
    batch = segments.gather(torch.arange(3))
    assert batch.values.shape == (3, 12, 1)
    assert bool(batch.values[1, 10:].isnan().all())
    assert batch.values[1, 0, 0] == 14
    assert bool((batch.times.diff(dim=1) > 0).all())
    assert batch.measured.tolist() == [12, 10, 9]


def test_beyond_its_end_a_trajectory_goes_on_in_its_mean_step():
    data = measured(rows=2, samples=8)
    times = torch.tensor([[0.0, 1, 2, 3, 5, 7, 9, 14], [10, 13, 14, 15, 16, NAN, NAN, NAN]]).double()
    data.values[0, 0] = data.values[1, 5:] = NAN
    batch = Segments(Observations(data.values, times), None, SEEN).gather(torch.tensor([0, 1]))
    assert batch.times[0].tolist() == [1, 2, 3, 5, 7, 9, 14, 16]
    assert batch.times[1].tolist() == [10, 13, 14, 15, 16, 17.5, 19, 20.5]
    assert batch.values[:, :, 0].isnan().tolist() == [[False] * 7 + [True], [False] * 5 + [True] * 3]


def test_gaps_lie_inside_but_not_where_a_start_is_guessed():
    data = measured(rows=1)
    data.values[0, [2, 4, 5]] = NAN
    segments = Segments(data, 5, SEEN)
    assert segments.begins[:, 1].tolist() == [3, 6]


def test_counting_ahead():
    there = torch.tensor([[True, False, True, True, False]])
    assert ahead(there, 3).tolist() == [[2, 2, 2, 1, 0]]


def test_stages_longer_than_all_trajectories_take_these_whole():
    data = measured()
    data.values[1, :2] = NAN
    long, whole = Segments(data, 64, SEEN), Segments(data, None, SEEN)
    assert long.intervals == 11
    assert long.begins.tolist() == whole.begins.tolist() == [[0, 0], [1, 2], [2, 0]]


def test_trajectories_without_an_initial_state_are_refused():
    data = measured()
    data.values[:, ::2] = NAN
    with pytest.raises(
        UserError, match="expected trajectories with at least 4 of 6 consecutive measurements"
    ):
        Segments(data, 5, SEEN)


def test_draws_depend_on_seed_and_epoch_and_go_on_inside_an_epoch():
    segments = Segments(measured(), 5, SEEN)
    loader = SegmentLoader(lambda _: (segments, 4), 3, seed=7)
    loader.set_epoch(2)
    whole = [batch.values for batch in loader]
    assert len(loader) == len(whole) == 3
    other = SegmentLoader(lambda _: (segments, 4), 3, seed=7)
    other.load_state_dict({"epoch": 2, "position": 1})
    other.set_epoch(2)
    rest = [batch.values for batch in other]
    assert all(torch.equal(a, b) for a, b in zip(whole[1:], rest, strict=True))
    loader.set_epoch(3)
    assert not torch.equal(next(iter(loader)).values, whole[0])


def test_a_stage_on_everything_takes_everything_in_each_step():
    segments = Segments(measured(), None, SEEN)
    steps = list(SegmentLoader(lambda _: (segments, len(segments)), 4, seed=7))
    assert [len(batch.values) for batch in steps] == [3, 3, 3, 3]
    once = list(SegmentLoader(lambda _: (segments, 2), 0, seed=7))
    assert [len(batch.values) for batch in once] == [2, 1]
