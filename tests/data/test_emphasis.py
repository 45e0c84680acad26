"""Windows are drawn in proportion to a power of the speed of their momenta, anew in each epoch."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator

from ahnn.data.loader import WindowLoader
from ahnn.data.windows import Windows
from ahnn.types import Trajectories

SPEEDS = torch.tensor([3.0, 1.0, 0.0, 8.0, 2.0, 5.0, 0.5, 4.0], dtype=torch.float64)


def with_speeds(speeds, steps=None):
    """Windows of one step, in order, whose momenta change at these speeds in changing directions."""
    count = len(speeds)
    angle = torch.arange(count, dtype=torch.float64)
    lengths = torch.ones(count, dtype=torch.float64) if steps is None else steps
    momenta = torch.stack((angle.cos(), angle.sin()), -1) * (speeds * lengths).unsqueeze(-1)
    zero = torch.zeros(1, 2, dtype=torch.float64)
    positions = 100 * torch.arange(count + 1, dtype=torch.float64).square().unsqueeze(-1).expand(-1, 2)
    states = torch.cat((positions, torch.cat((zero, momenta.cumsum(0)))), -1)
    times = 50 + torch.cat((zero[:, 0], lengths.cumsum(0)))
    return Windows(Trajectories(states.unsqueeze(0), times.unsqueeze(0)), 1, torch.float64)


def drawn(windows, emphasis, epochs, seed=3):
    loader = WindowLoader(windows, 4, None, seed, emphasis)
    orders = []
    for epoch in range(epochs):
        loader.set_epoch(epoch)
        orders.append(loader.order())
    return torch.stack(orders)


def test_speeds_are_those_of_the_momenta_and_have_mean_one():
    close(with_speeds(SPEEDS).speeds(), SPEEDS / SPEEDS.mean(), 1e-12)
    steps = 0.5 + torch.rand(len(SPEEDS), generator=generator(2), dtype=torch.float64)
    close(with_speeds(SPEEDS, steps).speeds(), SPEEDS / SPEEDS.mean(), 1e-12)


@pytest.mark.parametrize("emphasis", [0.5, 1.0, 2.0])
def test_windows_are_drawn_in_proportion_to_the_power_of_their_speed(emphasis):
    epochs = 4000
    order = drawn(with_speeds(SPEEDS), emphasis, epochs)
    share = SPEEDS**emphasis / (SPEEDS**emphasis).sum()
    total = epochs * len(SPEEDS)
    counts = torch.bincount(order.flatten(), minlength=len(SPEEDS)).double()
    deviation = (total * share * (1 - share)).sqrt()
    assert bool(((counts - total * share).abs() <= 4.5 * deviation).all())
    assert counts[2] == 0  # what stands still is never drawn


def test_draws_are_independent_with_replacement_and_differ_between_epochs():
    order = drawn(with_speeds(torch.ones(8)), 1.0, 500)
    distinct = torch.tensor([len(set(row)) for row in order.tolist()]).double()
    assert float(distinct.mean()) == pytest.approx(8 * (1 - (7 / 8) ** 8), abs=0.2)
    again = drawn(with_speeds(torch.ones(8)), 1.0, 500)
    assert torch.equal(order, again)
    assert len({str(row) for row in order.tolist()}) > 490
    assert not torch.equal(order, drawn(with_speeds(torch.ones(8)), 1.0, 500, seed=4))


def test_no_order_is_that_of_another_seed_one_epoch_later():
    windows = with_speeds(torch.ones(40))
    for emphasis in (0.0, 1.0):
        first, second = drawn(windows, emphasis, 3, seed=1), drawn(windows, emphasis, 3, seed=2)
        rows = {str(row) for row in (*first.tolist(), *second.tolist())}
        assert len(rows) == 6


def test_parts_of_a_batch_are_weighted_by_their_windows():
    windows = with_speeds(torch.ones(10))
    whole = WindowLoader(windows, 4, None, 0)
    parts = [WindowLoader(windows, 4, None, 0, rank=r, world=3) for r in range(3)]
    for batch, *own in zip(whole, *parts, strict=True):
        count = len(batch.start)
        kept = [part.start for part in own if part.weight]
        assert torch.equal(torch.cat(kept), batch.start)
        assert batch.weight == 1
        expected = [3 * (len(part.start) if part.weight else 0) / count for part in own]
        assert [part.weight for part in own] == pytest.approx(expected)
        assert sum(part.weight for part in own) == pytest.approx(3.0)
