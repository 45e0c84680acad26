"""Trajectories are finite up to their ends, or refused before anything is stored."""

from __future__ import annotations

import dataclasses
from unittest.mock import MagicMock

import pytest
import torch
from helpers import MOLNIYA, SPRING, SYSTEMS, data_module

from ahnn import progress
from ahnn.data import generate as room
from ahnn.data.generate import generate
from ahnn.errors import UserError

ESCAPING = dataclasses.replace(SYSTEMS["henon_heiles"], amplitude=(3.0, 4.0))


def test_trajectories_are_finite_up_to_their_ends_and_nan_beyond():
    system = dataclasses.replace(MOLNIYA, periods=0.1, dt=300.0)
    states, times, *_ = generate(system, 5, 0)
    lengths = system.durations(states[:, 0]) + 1
    within = torch.arange(states.shape[1]) < lengths.unsqueeze(-1)
    assert len(set(lengths.tolist())) > 1
    assert torch.equal(times, (300.0 * torch.arange(states.shape[1]).double()).expand_as(times))
    assert torch.equal(states.isfinite().all(-1), within)


def test_states_that_leave_all_bounds_are_refused_and_not_stored(tmp_path):
    with pytest.raises(UserError, match=r"henon_heiles: expected finite states; .* 10 of 10 ") as said:
        data_module(ESCAPING, str(tmp_path), steps=400).trajectories("train")
    assert "dt=0.05" in str(said.value)
    assert "Shorten system.dt" in str(said.value)
    assert not list(tmp_path.glob("*.safetensors"))


def test_one_state_that_is_not_finite_is_enough(monkeypatch):
    drawn = SPRING.initial_states(4, torch.Generator().manual_seed(0))
    drawn[2, 1] = torch.inf
    monkeypatch.setattr(type(SPRING), "initial_states", lambda _, count, __: drawn.repeat(4, 1)[:count])
    with pytest.raises(UserError, match=r"in trajectory 2 after 0 steps .* 1 of 4 trajectories diverge"):
        generate(dataclasses.replace(SPRING, steps=3), 4, 0)


@pytest.mark.parametrize("steps", [0, torch.iinfo(torch.int64).min])
def test_a_duration_that_is_none_is_refused(monkeypatch, steps):
    monkeypatch.setattr(type(SPRING), "durations", lambda *_: torch.tensor([5, steps]))
    with pytest.raises(UserError, match="zero or infinite durations for 1 of 2"):
        generate(SPRING, 2, 0)


def test_trajectories_beyond_the_memory_are_refused():
    with pytest.raises(UserError, match=r"system.steps.*: expected states of a trajectory that fit in"):
        generate(dataclasses.replace(SPRING, steps=10**15), 3, 0)


@pytest.mark.parametrize("rows", [1, 3, 4, 100])
def test_the_bar_is_full_when_all_is_generated(rows, monkeypatch):
    """Trajectories are made several at once, and the bar counts the steps of all of these."""
    bar, told = MagicMock(), []
    bar.__enter__.return_value = bar
    bar.add_task.side_effect = lambda _, total: told.append(total)
    monkeypatch.setattr(progress, "progress_bar", lambda: bar)
    bar.disable = False
    monkeypatch.setattr(room, "rows_of_part", lambda *_: rows)
    parts = [*room.generated(dataclasses.replace(SPRING, steps=12), 8, 0)]
    assert sum(len(part.states) for part in parts) == 8
    assert told == [bar.advance.call_count] == [12 * len(parts)]
