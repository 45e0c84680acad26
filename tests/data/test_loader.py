"""The order of batches depends on (seed, epoch) alone, and a cut epoch is finished exactly."""

from __future__ import annotations

from itertools import chain

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from ahnn.data.loader import WindowLoader
from ahnn.data.windows import Windows
from ahnn.types import Trajectories


def loader(count=23, batch=5, per_epoch=None, seed=7):
    """Windows whose start is their own index."""
    states = torch.arange(count + 1, dtype=torch.float64).view(1, -1, 1).expand(1, -1, 2)
    times = torch.arange(count + 1, dtype=torch.float64).unsqueeze(0)
    windows = Windows(Trajectories(states, times), 1, torch.float64)
    return WindowLoader(windows, batch, per_epoch, seed)


def epoch(source, number):
    source.set_epoch(number)
    return [window.start[:, 0].long().tolist() for window in source]


def flat(batches):
    return list(chain.from_iterable(batches))


@settings(deadline=None, max_examples=60)
@given(count=st.integers(1, 40), batch=st.integers(1, 12), seed=st.integers(0, 10**6))
def test_an_epoch_covers_each_window_once(count, batch, seed):
    source = loader(count, batch, seed=seed)
    batches = epoch(source, 3)
    assert sorted(flat(batches)) == list(range(count))
    assert len(batches) == len(source)
    assert all(len(b) == batch for b in batches[:-1])


def test_the_order_depends_on_seed_and_epoch_alone():
    source = loader()
    epochs = [epoch(source, n) for n in range(4)]
    torch.manual_seed(99)
    assert epoch(loader(), 2) == epochs[2]  # neither earlier epochs nor the global generator matter
    assert len({str(e) for e in epochs}) == 4
    assert epoch(loader(seed=8), 2) != epochs[2]


@settings(deadline=None, max_examples=80)
@given(count=st.integers(1, 40), batch=st.integers(1, 9), data=st.data())
def test_a_cut_epoch_goes_on_with_exactly_the_rest(count, batch, data):
    whole = loader(count, batch)
    first, second = epoch(whole, 4), epoch(whole, 5)
    cut = data.draw(st.integers(0, len(first)))
    begun = loader(count, batch)
    begun.set_epoch(4)
    iterator = iter(begun)
    seen = [next(iterator).start[:, 0].long().tolist() for _ in range(cut)]
    resumed = loader(count, batch)
    resumed.load_state_dict(begun.state_dict())
    rest = epoch(resumed, 4)
    if cut < len(first):
        assert seen + rest == first
    else:  # the state was taken after the last batch: Lightning begins the next epoch
        assert rest == first
    assert epoch(resumed, 5) == second


def test_the_state_of_an_ended_epoch_does_not_swallow_the_next():
    ended = loader()
    epoch(ended, 4)
    resumed = loader()
    resumed.load_state_dict(ended.state_dict())
    assert epoch(resumed, 5) == epoch(loader(), 5)
    assert epoch(resumed, 4) == epoch(loader(), 4)


def test_a_subsample_is_drawn_anew_in_each_epoch():
    source = loader(count=100, batch=8, per_epoch=20)
    first, second = (flat(epoch(source, n)) for n in (0, 1))
    assert len(first) == len(set(first)) == len(second) == 20
    assert set(first) != set(second)
    assert len(source) == 3


def test_validation_windows_are_evenly_spread_and_always_the_same():
    source = loader(count=100, batch=8, per_epoch=10, seed=None)
    assert flat(epoch(source, 0)) == list(range(0, 100, 10)) == flat(epoch(source, 1))


def test_a_fresh_loader_begins_with_the_first_batch_of_epoch_zero():
    fresh = loader()
    assert fresh.state_dict() == {"epoch": 0, "position": 0}
    assert [window.start[:, 0].long().tolist() for window in fresh] == epoch(loader(), 0)
    assert fresh.state_dict() == {"epoch": 0, "position": 0}


def test_a_pass_that_is_given_up_leaves_no_trace_in_the_next():
    source = loader()
    for number in (0, 3):
        source.set_epoch(number)
        begun = iter(source)
        next(begun)
        begun.close()
        assert epoch(source, number) == epoch(loader(), number)


def test_a_subsample_is_the_beginning_of_a_permutation_of_all():
    whole, some = loader(count=300, batch=8), loader(count=300, batch=8, per_epoch=30)
    for number in range(3):
        assert flat(epoch(some, number)) == flat(epoch(whole, number))[:30]
