"""Windows found by index arithmetic are those of a naive enumeration, and no other."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from ahnn.data.windows import Windows
from ahnn.errors import UserError
from ahnn.types import Trajectories


def numbered(lengths):
    """Trajectories whose samples say where they are: (trajectory, sample) as a state."""
    longest = max(lengths)
    states = torch.full((len(lengths), longest, 2), torch.nan, dtype=torch.float64)
    for b, length in enumerate(lengths):
        states[b, :length, 0] = 1000.0 * b
        states[b, :length, 1] = torch.arange(length, dtype=torch.float64) ** 2
    return Trajectories(states, torch.tensor(lengths), 0.1)


def naive(data, steps):
    """Every run of steps + 1 valid samples of one trajectory, in order."""
    return [
        states[k : k + steps + 1]
        for states, length in zip(data.states, data.lengths.tolist(), strict=True)
        for k in range(length - steps)
    ]


@settings(deadline=None, max_examples=150)
@given(lengths=st.lists(st.integers(1, 9), min_size=1, max_size=6), steps=st.integers(1, 9))
def test_windows_equal_a_naive_enumeration(lengths, steps):
    data = numbered(lengths)
    expected = naive(data, steps)
    if not expected:
        with pytest.raises(UserError, match=f"W={steps}"):
            Windows(data, steps, torch.float64)
        return
    windows = Windows(data, steps, torch.float64)
    assert len(windows) == len(expected)
    batch = windows.gather(torch.arange(len(windows)))
    samples = torch.stack(expected)
    assert torch.equal(batch.start, samples[:, 0])
    assert torch.equal(batch.increments, samples[:, 1:] - samples[:, :-1])
    assert bool((batch.increments[..., 0] == 0).all())  # none straddles two trajectories
    assert batch.dt == 0.1


def test_increments_are_formed_in_float64_before_they_are_cast():
    states = torch.tensor([[[60000.0], [60000.001], [60000.003]]], dtype=torch.float64).expand(1, 3, 2)
    windows = Windows(Trajectories(states, torch.tensor([3]), 60.0), 2, torch.float32)
    batch = windows.gather(torch.tensor([0]))
    assert batch.increments.dtype == batch.start.dtype == torch.float32
    expected = torch.tensor([0.001, 0.002], dtype=torch.float64)
    relative = batch.increments[0, :, 0].double() / expected - 1
    assert float(relative.abs().max()) < 1e-7
