"""Windows found by index arithmetic are those of a naive enumeration, and no other."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from ahnn.data.windows import Windows, on_clock, require_span
from ahnn.errors import UserError
from ahnn.types import Trajectories


def numbered(segments, dt=0.1):
    """Trajectories of segments with a missing sample between; a sample says where it is."""
    rows = [sum(lengths) + len(lengths) - 1 for lengths in segments]
    states = torch.full((len(segments), max(rows), 2), torch.nan, dtype=torch.float64)
    for b, lengths in enumerate(segments):
        begin = 0
        for length in lengths:
            states[b, begin : begin + length, 0] = 1000.0 * b + begin
            states[b, begin : begin + length, 1] = torch.arange(length, dtype=torch.float64) ** 2
            begin += length + 1
    times = torch.arange(max(rows), dtype=torch.float64) * dt
    return Trajectories(states, times.expand(len(segments), -1))


def naive(data, steps):
    """Where every run of steps + 1 samples that are there begins, in order."""
    samples = data.states.shape[1]
    return [
        (b, k)
        for b in range(len(data.states))
        for k in range(samples - steps)
        if bool(data.present[b, k : k + steps + 1].all())
    ]


STRETCHES = st.lists(st.lists(st.integers(1, 7), min_size=1, max_size=3), min_size=1, max_size=5)


@settings(deadline=None, max_examples=150)
@given(segments=STRETCHES, steps=st.integers(1, 7))
def test_windows_equal_a_naive_enumeration(segments, steps):
    data = numbered(segments)
    expected = naive(data, steps)
    if not expected:
        with pytest.raises(UserError, match=f"received window={steps}|to form windows; received none"):
            Windows(data, steps, torch.float64)
        return
    windows = Windows(data, steps, torch.float64)
    assert len(windows) == len(expected)
    batch = windows.gather(torch.arange(len(windows)))
    samples = torch.stack([data.states[b, k : k + steps + 1] for b, k in expected])
    assert torch.equal(batch.start, samples[:, 0])
    assert torch.equal(batch.increments, samples[:, 1:] - samples[:, :-1])
    assert bool((batch.increments[..., 0] == 0).all())  # none straddles two segments
    assert batch.dt == 0.1


@settings(deadline=None, max_examples=60)
@given(segments=STRETCHES, steps=st.integers(1, 4), seed=st.integers(0, 1000))
def test_windows_of_irregular_samples_have_their_own_steps(segments, steps, seed):
    data = numbered(segments)
    draw = torch.Generator().manual_seed(seed)
    shape = data.times.shape
    times = (0.1 + torch.rand(shape, generator=draw, dtype=torch.float64)).cumsum(1)
    data = data._replace(times=times)
    if not (expected := naive(data, steps)):
        return
    windows = Windows(data, steps, torch.float64)
    batch = windows.gather(torch.arange(len(windows)))
    own = torch.stack([times[b, k : k + steps + 1].diff() for b, k in expected])
    if isinstance(batch.dt, float):  # a single step in all the data
        assert float((own - batch.dt).abs().max()) < 1e-12
        return
    assert torch.equal(batch.dt, own)
    rates = batch.increments[:, 0, 1].abs() / own[:, 0]
    if float(rates.sum()) > 0:
        assert torch.allclose(windows.speeds(), rates / rates.mean(), rtol=1e-12)


def test_times_that_are_sums_of_steps_are_one_step():
    data = numbered([[1500]], dt=60.0)
    assert Windows(data._replace(times=data.times + 4e8), 1, torch.float64).dt == 60.0
    assert Windows(numbered([[40]], dt=0.1), 1, torch.float64).dt == 0.1


def test_increments_are_formed_in_float64_before_they_are_cast():
    states = torch.tensor([[[60000.0], [60000.001], [60000.003]]], dtype=torch.float64).expand(1, 3, 2)
    windows = Windows(Trajectories(states, 60.0 * torch.arange(3.0).double().unsqueeze(0)), 2, torch.float32)
    batch = windows.gather(torch.tensor([0]))
    assert batch.increments.dtype == batch.start.dtype == torch.float32
    expected = torch.tensor([0.001, 0.002], dtype=torch.float64)
    relative = batch.increments[0, :, 0].double() / expected - 1
    assert float(relative.abs().max()) < 1e-7


def test_samples_that_stand_alone_are_named_and_not_windows_of_one_to_no_steps():
    with pytest.raises(UserError, match="expected at least two consecutive samples"):
        Windows(numbered([[1, 1], [1]]), 3, torch.float64)
    with pytest.raises(UserError, match="expected windows of 1 to 1 steps"):
        Windows(numbered([[2, 1]]), 3, torch.float64)


@pytest.mark.parametrize(
    ("longest", "steps", "window", "message"),
    [
        (4, 5, 5, "window: expected windows of 1 to 4 steps, .* received window=5. Set window=4 or less$"),
        (1, 5, None, "window: expected windows of 1 to 1 steps, .* received window=5. Set window=1$"),
        (9, 12, 5, "^loss.order: .* received loss.order=12. Set loss.order=8 or less, or loss.derivative=0,"),
        (
            1,
            12,
            1,
            "^loss.order: .* received loss.order=12. Set loss.derivative=0, which fits no derivatives",
        ),
        (
            4,
            12,
            5,
            "^window, loss.order: .* window=5, loss.order=12. Set window=4 or less, and loss.order=4 or less",
        ),
    ],
)
def test_windows_too_long_name_their_own_key_and_remedy(longest, steps, window, message):
    with pytest.raises(UserError, match=message):
        require_span(steps, longest, window)
    with pytest.raises(UserError, match=message):
        Windows(numbered([[longest + 1]]), steps, torch.float64, window)


def test_states_are_put_on_the_clock_of_their_trajectories():
    data = numbered([[3], [3]])
    assert on_clock(data, 0) is data
    timed = on_clock(data, 1).states
    assert torch.equal(timed[..., 1], data.times)
    assert torch.equal(timed[..., 3], torch.ones_like(data.times))
    assert torch.equal(timed[..., ::2], data.states)
    driven = on_clock(data._replace(controls=7 * data.times.unsqueeze(-1)), 2).states
    assert torch.equal(driven[..., 2], 7 * data.times)
    with pytest.raises(UserError, match="forces: expected trajectories with controls; received none"):
        on_clock(data, 2)
