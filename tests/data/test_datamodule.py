"""Splits are by trajectory and disjoint; statistics come from the training split alone."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from helpers import MOLNIYA, SPRING, close, data_module
from hypothesis import given
from hypothesis import strategies as st

from ahnn.data import SPLITS
from ahnn.data.splits import split_sizes
from ahnn.errors import UserError


def test_splits_are_disjoint_and_cover_all_trajectories(cache):
    data = data_module(SPRING, cache, trajectories=20)
    starts = [tuple(x.tolist()) for split in SPLITS for x in data.trajectories(split).states[:, 0]]
    assert len(starts) == len(set(starts)) == 20
    assert [len(data.trajectories(split).states) for split in SPLITS] == [12, 4, 4]


def test_the_papers_split(cache):
    assert split_sizes(2500, [0.80, 0.15, 0.05]) == [2000, 375, 125]
    assert [len(data_module(SPRING, cache).trajectories(s).states) for s in SPLITS] == [6, 2, 2]


@given(count=st.integers(1, 5000), shares=st.tuples(st.floats(0.01, 0.4), st.floats(0.01, 0.4)))
def test_split_sizes_add_up_or_are_refused(count, shares):
    shares = [1 - sum(shares), *shares]
    rest = [round(s * count) for s in shares[1:]]
    if count < 3:
        with pytest.raises(UserError, match=f"received {count} traject"):
            split_sizes(count, shares)
        return
    sizes = split_sizes(count, shares)
    assert sum(sizes) == count
    assert min(sizes) >= 1
    rounded = [count - sum(rest), *rest]
    if min(rounded) >= 1:
        assert sizes == rounded
    for size, share in zip(sizes, shares, strict=True):
        assert abs(size - share * count) <= 2


@pytest.mark.parametrize(
    "shares",
    [
        [0.5, 0.5],
        [0.5, 0.5, 0.0],
        [0.8, 0.3, -0.1],
        [0.5, 0.2, 0.2],
        [math.nan, 0.5, 0.5],
        [math.inf, 0.5, 0.5],
    ],
)
def test_shares_that_do_not_split_are_refused(shares):
    with pytest.raises(UserError, match="sum to 1"):
        split_sizes(100, shares)


def test_an_empty_split_is_refused(cache):
    with pytest.raises(UserError, match=r"each of train, val, test; received 2 trajectories"):
        data_module(SPRING, cache, trajectories=2, split=[0.8, 0.1, 0.1]).trajectories("train")


def test_a_window_longer_than_a_trajectory_is_refused(cache):
    with pytest.raises(UserError, match=r"windows of 1 to 40 steps.*received window=41"):
        data_module(SPRING, cache, window=41).train_dataloader()


@pytest.mark.parametrize(
    "change",
    [
        {"window": 0},
        {"window": -1},
        {"batch_size": 0},
        {"windows_per_epoch": 0},
        {"val_windows": -1},
        {"emphasis": -1.0},
        {"emphasis": math.nan},
        {"emphasis": math.inf},
    ],
)
def test_impossible_options_are_refused_by_name(cache, change):
    with pytest.raises(UserError, match=next(iter(change))):
        data_module(SPRING, cache, **change)


@pytest.mark.parametrize("system", [SPRING, dataclasses.replace(MOLNIYA, periods=0.1, dt=300.0)])
def test_statistics_come_from_the_training_split_alone(cache, system):
    data = data_module(system, cache)
    statistics = data.statistics()
    states = data.trajectories("train").states.double()
    rows = [s[there] for s, there in zip(states, data.trajectories("train").present, strict=True)]
    valid = torch.cat(rows)
    increments = torch.cat([s.diff(dim=0) for s in rows])
    close(statistics.minimum, valid.min(0).values, 0.0)
    close(statistics.maximum, valid.max(0).values, 0.0)
    close(statistics.increment, (increments**2).mean(0).sqrt(), 1e-14)
    r = valid[:, : system.dof].pow(2).sum(1).sqrt()
    close(statistics.radius, torch.stack((r.min(), r.max())), 1e-15)
    close(statistics.rate, statistics.increment / system.dt, 1e-15)
    for split in ("val", "test"):
        data.trajectories(split).states.fill_(1e9)
    again = data.statistics()
    assert (again.dt, again.force_sd) == (statistics.dt, None)
    tensors = [[part for part in one if isinstance(part, torch.Tensor)] for one in (statistics, again)]
    for a, b in zip(*tensors, strict=True):
        assert torch.equal(a, b)


def test_training_and_validation_batches_come_from_their_own_splits(cache):
    data = data_module(SPRING, cache, batch_size=7, window=2)
    for split, loader in (("train", data.train_dataloader()), ("val", data.val_dataloader())):
        starts = torch.cat([batch.start for batch in loader])
        own = data.trajectories(split).states[:, :-2].flatten(0, 1)
        assert sorted(starts.tolist()) == sorted(own.tolist())


def test_the_same_data_come_from_the_cache(cache):
    first = data_module(SPRING, cache, seed=11).trajectories("train")
    second = data_module(SPRING, cache, seed=11, window=5, order_seed=3).trajectories("train")
    other = data_module(SPRING, cache, seed=12).trajectories("train")
    assert torch.equal(first.states, second.states)
    assert not torch.equal(first.states, other.states)
