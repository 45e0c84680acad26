"""Data larger than what is worked on at once: the same trajectories, windows and statistics part by part."""

from __future__ import annotations

import dataclasses
import weakref

import pytest
import torch
from helpers import MOLNIYA, SPRING, SYSTEMS, close, data_module, generator

from ahnn.data import Simulated, store
from ahnn.data.generate import generate, generated
from ahnn.data.loader import WindowLoader, ahead, distinct
from ahnn.data.windows import Windows
from ahnn.errors import UserError
from ahnn.statistics import Statistics
from ahnn.types import Trajectories

SHORT = dataclasses.replace(SPRING, steps=12)
RECIPE = store.recipe(SHORT, 21, 0)


@pytest.fixture
def few(monkeypatch):
    """A function that lets a part hold so many of some trajectories."""
    return lambda data, rows: monkeypatch.setattr("ahnn.types.PART", rows * data.states[0].nbytes)


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=SYSTEMS)
def test_trajectories_do_not_depend_on_the_parts_they_are_made_in(system, few):
    system = dataclasses.replace(system, steps=12)
    whole = generate(system, 21, 0)
    few(whole, 4)
    parts = [*generated(system, 21, 0)]
    assert [len(part.states) for part in parts] == [4] * 5 + [1]
    again = generate(system, 21, 0)
    assert torch.equal(again.states, whole.states)
    assert torch.equal(again.times, whole.times)


def test_parts_are_as_long_as_the_longest_of_all(few):
    system = dataclasses.replace(MOLNIYA, periods=0.05, dt=300.0)
    whole = generate(system, 6, 0)
    few(whole, 1)
    again = generate(system, 6, 0)
    assert bool(whole.states.isnan().any())
    assert torch.equal(again.states.nan_to_num(7.0), whole.states.nan_to_num(7.0))


def test_a_store_is_the_same_file_whatever_the_parts(tmp_path, few):
    whole = generate(SHORT, 21, 0)
    store.write(tmp_path / "whole", [whole], RECIPE)
    few(whole, 4)
    store.write(tmp_path / "parts", generated(SHORT, 21, 0), RECIPE)
    assert (tmp_path / "parts").read_bytes() == (tmp_path / "whole").read_bytes()
    assert torch.equal(store.read(tmp_path / "parts").states, whole.states)
    assert store.checksum(whole) in (tmp_path / "parts").read_bytes().decode("latin1")


def test_a_store_holds_two_parts_at_most_while_it_is_written(tmp_path):
    alive = []

    def parts():
        for seed in range(5):
            part = torch.randn(3, 13, 2, generator=generator(seed), dtype=torch.float64)
            alive.append(weakref.ref(part))
            assert sum(made() is not None for made in alive) <= 2
            yield Trajectories(part, torch.arange(13, dtype=torch.float64).expand(3, -1))

    store.write(tmp_path / "x", parts(), RECIPE)
    assert store.read(tmp_path / "x").states.shape == (15, 13, 2)


def test_what_was_made_is_mapped_and_the_file_keeps_what_it_has(tmp_path):
    made = store.load_or_make(tmp_path, RECIPE, lambda: generated(SHORT, 21, 0))
    (path,) = tmp_path.glob("*.safetensors")
    before = path.read_bytes()
    with open("/proc/self/maps") as maps:
        assert str(path) in maps.read()
    made.states.zero_()
    assert path.read_bytes() == before


@pytest.mark.parametrize("uniform", [True, False])
def test_statistics_of_parts_are_those_of_the_whole(uniform, few):
    states, times, *_ = generate(dataclasses.replace(MOLNIYA, steps=40), 9, 0)
    states[2, 30:], states[5, 7] = torch.nan, torch.nan
    if not uniform:
        times = times + torch.rand(times.shape, generator=generator(0), dtype=torch.float64)
    data = Trajectories(states, times)
    whole = Statistics.of(data)
    few(data, 2)
    parts = Statistics.of(data)
    for name in ("minimum", "maximum", "radius"):
        assert torch.equal(getattr(parts, name), getattr(whole, name))
    for name in ("increment", "rate"):
        close(getattr(parts, name), getattr(whole, name), 1e-13)
    spread = Statistics.of(Trajectories(states[::5], times[::5]))
    assert torch.equal(parts.positions, spread.positions)
    assert torch.equal(parts.forces, spread.forces)
    assert parts.dt == (whole.dt if uniform else spread.dt)


def test_windows_are_found_part_by_part(few):
    states, times, *_ = generate(SHORT, 7, 0)
    states[1, 5], states[4, :3] = torch.nan, torch.nan
    data = Trajectories(states, times)
    whole = Windows(data, 3, torch.float64)
    few(data, 2)
    parts = Windows(data, 3, torch.float64)
    every = torch.arange(len(whole))
    assert len(parts) == len(whole)
    assert torch.equal(parts.gather(every).increments, whole.gather(every).increments)


def test_speeds_are_found_part_by_part(monkeypatch):
    windows = Windows(generate(SHORT, 7, 0), 3, torch.float64)
    whole = windows.speeds()
    monkeypatch.setattr("ahnn.data.windows.SPEEDS", 5)
    assert torch.equal(windows.speeds(), whole)


def test_streamed_batches_are_those_that_are_not(monkeypatch):
    windows = Windows(generate(SHORT, 7, 0), 3, torch.float64)
    loader = WindowLoader(windows, 4, None, 3)
    assert not loader.streamed
    plain = [*loader]
    monkeypatch.setattr("ahnn.data.windows.STREAMED", 0)
    assert loader.streamed
    streamed = [*loader]
    assert len(streamed) == len(plain) > 4
    assert all(torch.equal(a.increments, b.increments) for a, b in zip(streamed, plain, strict=True))
    begun = iter(loader)
    next(begun)
    next(begun)
    assert loader.state_dict() == {"epoch": 0, "position": 2}  # what was gathered ahead was not used yet
    begun.close()


def test_what_fails_in_the_background_is_told():
    def gather(batch):
        if int(batch) == 6:
            message = "lost disk"
            raise OSError(message)
        return int(batch)

    batches, seen = torch.arange(9).split(1), []
    with pytest.raises(OSError, match="lost disk"):
        seen.extend(ahead(gather, batches))
    assert seen == [*range(6)]


def test_few_windows_of_very_many_are_drawn_without_a_permutation(monkeypatch):
    loader = WindowLoader(Windows(generate(SHORT, 40, 0), 3, torch.float64), 4, 30, 3)
    monkeypatch.setattr("ahnn.data.loader.PERMUTED", 100)
    monkeypatch.setattr(torch, "randperm", lambda *_, **__: pytest.fail("a permutation of all"))
    first, again = loader.order(), loader.order()
    loader.set_epoch(1)
    assert torch.equal(first, again)
    assert not torch.equal(first, loader.order())
    assert first.unique().numel() == 30
    assert 0 <= int(first.min()) < int(first.max()) < len(loader.windows)


def test_windows_are_a_part_of_a_permutation_where_they_are_few_or_most_are_drawn(monkeypatch):
    """And none of that where fast ones are drawn more often."""
    windows = Windows(generate(SHORT, 40, 0), 3, torch.float64)
    monkeypatch.setattr("ahnn.data.loader.distinct", lambda *_: pytest.fail("no permutation"))
    assert WindowLoader(windows, 4, 30, 3).order().unique().numel() == 30
    monkeypatch.setattr("ahnn.data.loader.PERMUTED", 100)
    for count in (len(windows) // 2, len(windows)):
        assert WindowLoader(windows, 4, count, 3).order().unique().numel() == count
    assert len(WindowLoader(windows, 4, 30, 3, emphasis=1.0).order()) == 30


def test_distinct_draws_are_in_random_order():
    pairs = [tuple(distinct(4, 2, generator(seed)).tolist()) for seed in range(1200)]
    counts = [pairs.count((a, b)) for a in range(4) for b in range(4) if a != b]
    assert sum(counts) == 1200
    assert sum((n - 100) ** 2 / 100 for n in counts) < 31.3  # chi-square of 11 degrees: one in a thousand


def test_a_store_beyond_the_memory_is_taken_and_one_beyond_the_disk_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("ahnn.memory.available", lambda: 1000)
    source = Simulated(SHORT, trajectories=100, seed=0, cache=str(tmp_path / "cache"))
    source.check()
    monkeypatch.setattr("ahnn.memory.shutil.disk_usage", lambda _: type("Usage", (), {"free": 20_000}))
    message = r"data.trajectories, system.steps: expected trajectories that fit in the 0 GB free at .*cache;"
    with pytest.raises(UserError, match=message):
        source.check()
    monkeypatch.undo()
    source.read()
    monkeypatch.setattr("ahnn.memory.shutil.disk_usage", lambda _: type("Usage", (), {"free": 0}))
    source.check()  # it is there


def test_a_data_module_of_many_parts_trains_on_the_same_windows(cache, few):
    whole = data_module(SPRING, cache, trajectories=20)
    batches = [window.increments for window in whole.train_dataloader()]
    examples = whole.examples()
    few(whole.trajectories("train"), 3)
    parts = data_module(SPRING, cache, trajectories=20)
    again = [window.increments for window in parts.train_dataloader()]
    assert all(torch.equal(a, b) for a, b in zip(batches, again, strict=True))
    assert len(parts.examples()) == len(examples) // 4
