"""A rollout applies a flow to its own output, with the step that is due."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import close, generator

from ahnn.rollouts import rollout

START = torch.randn(3, 4, generator=generator(0), dtype=torch.float64)


def decay(x, dt):
    """The exact flow of x' = -x, with a step for all or one for each."""
    return x * (-torch.as_tensor(dt, dtype=torch.float64).unsqueeze(-1)).exp()


def test_a_rollout_of_an_exact_flow_is_its_closed_form():
    times = 0.3 * torch.arange(8, dtype=torch.float64)
    got = rollout(decay, START, 0.3, 8)
    close(got, START.unsqueeze(1) * (-times).exp().view(1, -1, 1), 1e-13)
    assert torch.equal(got[:, 0], START)


def test_every_member_takes_its_own_steps_in_their_order():
    steps = 0.1 + torch.rand(3, 7, generator=generator(1), dtype=torch.float64)
    times = torch.cat((torch.zeros(3, 1), steps.cumsum(1)), dim=1)
    close(rollout(decay, START, steps, 8), START.unsqueeze(1) * (-times).exp().unsqueeze(-1), 1e-13)


@pytest.mark.parametrize("description", [None, "rolling out"])
def test_the_flow_is_called_once_for_each_sample_after_the_first(description):
    calls = []

    def flow(x, dt):
        calls.append((x.clone(), dt))
        return x + 1.0

    got = rollout(flow, START, 0.5, 5, description)
    assert len(calls) == 4
    assert {dt for _, dt in calls} == {0.5}
    close(got, START.unsqueeze(1) + torch.arange(5.0).view(1, -1, 1), 1e-14)
    assert rollout(flow, START, 0.5, 1, description).shape == (3, 1, 4)


def test_steps_that_are_too_long_are_cut_into_equal_parts():
    calls = []

    def flow(x, dt):
        calls.append(dt)
        return decay(x, dt)

    steps = torch.tensor([[0.1, 0.3], [0.1, 0.2]], dtype=torch.float64)
    got = rollout(flow, START[:2], steps, 3, longest=0.1)
    close(got[:, -1], START[:2] * (-steps.sum(1, keepdim=True)).exp(), 1e-13)
    assert len(calls) == 4
    close(torch.stack(calls[1:]), (steps[:, 1] / 3).expand(3, 2), 1e-13)
    calls.clear()
    rollout(flow, START, 0.3, 2, longest=0.1 - 1e-12)
    assert calls == [0.3 / 3] * 3


@pytest.mark.parametrize("longest", [math.inf, 0.1])
def test_a_trajectory_that_has_ended_ends_no_other(longest):
    steps = torch.tensor([[0.1, 0.3], [0.2, math.nan]], dtype=torch.float64)
    got = rollout(decay, START[:2], steps, 3, longest=longest)
    close(got[0, -1], START[0] * math.exp(-0.4), 1e-13)
    close(got[:, 1], START[:2] * (-steps[:, :1]).exp(), 1e-13)
    assert bool(got[1, -1].isnan().all())


def test_a_rollout_keeps_the_type_and_asks_for_no_gradients():
    start = START.float().requires_grad_()
    got = rollout(lambda x, _: 2 * x, start, 0.1, 3)
    assert got.dtype == torch.float32
    assert not got.requires_grad
