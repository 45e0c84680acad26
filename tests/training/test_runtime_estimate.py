"""The announced time of a training on measurements counts its last steps."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch
from oscillators import Swing

from ahnn.measurements import Instrument, Observations, Position
from ahnn.training import closing_estimate, runtime_estimate, timers
from ahnn.training.shooting import Shooting
from ahnn.training.weak import Weak


class Batches:
    """Batches of 200 segments of 5 times, from the second epoch on of 50 segments of 20."""

    shape = 200, 5

    def set_epoch(self, epoch):
        self.shape = (200, 5) if epoch < 1 else (50, 20)

    def __iter__(self):
        yield SimpleNamespace(times=torch.zeros(self.shape))


class Data:
    """Measurements: 100 trajectories of 10 times for the training, 20 for a validation."""

    stages = object()

    def train_dataloader(self):
        return Batches()

    def val_dataloader(self):
        return [SimpleNamespace(times=torch.zeros(20, 10))]

    def measured(self, split):
        assert split == "train"
        return SimpleNamespace(times=torch.zeros(100, 10))


class FourBatches:
    """Four batches of five windows, which are gathered as their own indices."""

    def __len__(self):
        return 4

    def batches(self):
        return torch.arange(20).split(5)

    def gather(self, batch):
        return batch


@pytest.mark.parametrize(
    ("first", "steps", "quartered", "fits"),
    [
        (Shooting(4), 0, False, 40),
        (Shooting(4), 0, True, 160),
        (Shooting(4, "student"), 0, False, 65),
        (Weak(), 3, False, 55),
    ],
)
def test_last_steps_and_the_covariance_count_by_all_measurements(first, steps, quartered, fits, monkeypatch):
    """A step of 200 segments takes 1 s, one of 50 longer ones 2 s; an iteration 0.2 s, equations 0.1 s."""
    monkeypatch.setattr(runtime_estimate, "step_seconds", lambda *_: 1.0)
    cost = closing_estimate.ShootingCost(1e-4, 5e-5, quartered)
    monkeypatch.setattr(closing_estimate, "sum_seconds", lambda: 0.01)
    at = lambda epoch, epochs: first if (epoch, epochs) == (0, 2) else None  # noqa: E731
    curriculum = SimpleNamespace(at=at, closing=steps)
    model, trainer = SimpleNamespace(curriculum=curriculum), SimpleNamespace(callbacks=[])
    seconds = runtime_estimate.expected_seconds(trainer, Data(), model, 3, range(2), cost)  # pyright: ignore
    validation = 0.5 * 10 * (20 + 100) / (5 * (200 + 100))
    directions = 0.01 * 4 * 10
    equations = 5 * 0.1 * (4 if quartered else 1)
    assert seconds == pytest.approx(3 + 3 * 2 + 2 * validation + 0.2 * fits + equations + directions)


def test_epochs_count_by_what_they_work_through():
    """Three steps and a validation in steps of a segment; the fixed part of each counts as 100 segments."""
    validation = 0.5 * 10 * 120
    expected = [3 * 5 * 300 + validation, *[3 * 20 * 150 + validation] * 2]
    assert runtime_estimate.amounts(Data(), 3, range(3)) == expected  # pyright: ignore
    assert runtime_estimate.amounts(SimpleNamespace(stages=None), 3, range(3)) == [1, 1, 1]  # pyright: ignore


@pytest.mark.parametrize(("each", "calls"), [(0.01, 4), (0.2, 3), (2.0, 2)])
def test_steps_that_take_long_are_timed_once(each, calls, monkeypatch):
    done = []
    monkeypatch.setattr(timers.time, "perf_counter", lambda: each * len(done))
    assert timers.median_seconds(lambda: done.append(0), 3) == pytest.approx(each)
    assert len(done) == calls


@pytest.mark.parametrize(("fixed", "whole", "shares"), [(0.01, 1.0, [1 / 8, 1 / 8, 1, 1]), (3.0, 60.0, None)])
def test_long_steps_are_timed_on_shares_of_a_batch(fixed, whole, shares, monkeypatch):
    """A step takes a fixed time and one in proportion to its batch; a long one is never taken as a whole."""
    clock, done = [0.0], []

    def work(share):
        clock[0] += fixed + whole * share
        done.append(share)

    monkeypatch.setattr(timers.time, "perf_counter", lambda: clock[0])
    assert runtime_estimate._of_whole(work) == pytest.approx(fixed + whole)
    assert done == (shares or [1 / 8, 1 / 8, 1 / 4])


def test_each_epoch_counts_its_steps_its_validation_and_the_callbacks_that_say_so(monkeypatch):
    """Epochs 2 to 4 of 5: steps of 0.5 s up to the third, of 2 s after it, and validations of 3 s."""
    one, other = object(), object()
    monkeypatch.setattr(runtime_estimate, "step_seconds", lambda *given: {one: 0.5, other: 2.0}[given[-1]])
    monkeypatch.setattr(runtime_estimate, "_validation_seconds", lambda *_: 3.0)
    curriculum = SimpleNamespace(at=lambda epoch, epochs: one if epoch < 3 < epochs else other)
    slow = SimpleNamespace(seconds=lambda epoch, *_: 100.0 * epoch)
    trainer = SimpleNamespace(callbacks=[SimpleNamespace(), slow])
    model, data = SimpleNamespace(curriculum=curriculum), SimpleNamespace(stages=None)
    seconds = runtime_estimate.expected_seconds(trainer, data, model, 7, range(2, 5))  # pyright: ignore
    assert seconds == pytest.approx(3.5 + 14 + 14 + 3 * 3 + 100 * (2 + 3 + 4))


def test_a_validation_takes_as_long_as_its_first_batch_for_each_of_them(monkeypatch):
    seen = []
    monkeypatch.setattr(runtime_estimate, "_of_whole", lambda work: work(0.3) or 3.0)
    judge = SimpleNamespace(validation=lambda dynamics, batch: seen.append((dynamics, batch.tolist())))
    model = SimpleNamespace(dynamics="dynamics", curriculum=SimpleNamespace(judge=judge))
    loader = FourBatches()
    data = SimpleNamespace(val_dataloader=lambda: loader)
    assert runtime_estimate._validation_seconds(model, data) == 12.0  # pyright: ignore
    assert seen == [("dynamics", [0, 1])]


@pytest.mark.parametrize(("rows", "samples"), [(4, 20), (320, 80)])
def test_an_iteration_is_timed_on_the_beginnings_of_some_trajectories(rows, samples, monkeypatch):
    """By its work; the rows and intervals of the beginnings are bounded."""
    seen, durations = [], iter([6.0, 2.0])

    def timed(work):
        work()
        return next(durations)

    def equations(problem, theta, sizes):
        seen.append((problem.batch, problem.fitted, theta.tolist(), sizes))

    monkeypatch.setattr(closing_estimate, "median_seconds", timed)
    monkeypatch.setattr(closing_estimate._Unfitted, "equations", equations)
    times = 0.1 * torch.arange(samples, dtype=torch.float64).expand(rows, -1)
    data = SimpleNamespace(
        measured=lambda _: Observations(times.sin().unsqueeze(-1), times),
        instrument=Instrument(Position(1), torch.ones(1), 1.0, 1, 1.0),
    )
    model = SimpleNamespace(dynamics=Swing(2.5, 0.5))
    shape = min(rows, closing_estimate.SEGMENTS), min(samples, closing_estimate.INTERVALS + 1)
    found = closing_estimate.shooting_cost(model, data)  # pyright: ignore
    amount = shape[1] * (shape[0] + 100)
    assert found.iteration == pytest.approx(4.0 / amount, rel=1e-12)
    assert found.equations == pytest.approx(2.0 / amount, rel=1e-12)
    assert not found.quartered
    batch, fitted, *asked = seen[0]
    assert batch.values.shape == (*batch.times.shape, 1)
    assert batch.times.shape == shape
    assert asked == [[2.5, 0.5], [2]]
    assert float(fitted.sums.abs().max()) == 0.0
    assert len(seen) == 2


def test_steps_that_the_closing_stage_quarters_are_noticed():
    times = 2.0 * torch.arange(20, dtype=torch.float64).expand(4, -1)
    data = SimpleNamespace(
        measured=lambda _: Observations(times.sin().unsqueeze(-1), times),
        instrument=Instrument(Position(1), torch.ones(1), 2.0, 1, 2.0),
    )
    found = closing_estimate.shooting_cost(SimpleNamespace(dynamics=Swing(2.5, 0.5)), data)  # pyright: ignore
    assert found.quartered
    assert found.iteration >= 0 < found.equations


def test_what_is_timed_once_is_done_once_before(monkeypatch):
    done = []
    monkeypatch.setattr(timers.time, "perf_counter", lambda: {0: 0.0, 1: 0.08, 2: 0.09}[len(done)])
    assert timers.median_seconds(lambda: done.append(0)) == pytest.approx(0.01)
    assert len(done) == 2
