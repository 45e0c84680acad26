"""Runs of readings: the same bits as reading by reading, step by step, whatever lies between them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from following import MEAN, P0, SPACE, STEP, Q, coast, make, readings
from hypothesis import given, settings
from hypothesis import strategies as st

from ahnn.assimilation import Assimilation, Reading, StreamSensor
from ahnn.assimilation.reading_runs import ReadingRuns
from ahnn.compiled_libraries import CompiledFlow
from ahnn.estimation import Gate, initial_belief
from ahnn.measurements import Position
from ahnn.systems import Molniya
from ahnn.systems.truth import exact_flow
from ahnn_plugins.ukf import UnscentedKalmanFilter, online_process
from ahnn_plugins.ukf.library import library

MOLNIYA = Molniya(name="molniya", dt=60.0, steps=60)


@pytest.fixture(autouse=True)
def _compiled():
    if library() is None:
        pytest.skip("no C compiler")


def ruled(count, seed=0):
    """Readings of one sensor; some are outliers, empty, late or there already, and some gaps are long."""
    draw = np.random.default_rng(seed)
    times = np.cumsum(draw.choice([0.1, 0.4, 1.7], count))
    values = 1.2 + 0.25 * times + 0.05 * draw.normal(size=count)
    values[draw.uniform(size=count) < 0.06] += 40.0
    values[draw.uniform(size=count) < 0.06] = np.nan
    found = [Reading(t, (v,), "ruler") for t, v in zip(times.tolist(), values.tolist(), strict=True)]
    for k in range(7, count, 11):
        found[k - 1], found[k] = found[k], found[k - 1]
    return [one for k, one in enumerate(found) for _ in range(1 + (k % 13 == 5))]


def followed(filtering, found, cuts):
    """Estimates after readings that arrive in blocks, and how many came of runs."""
    told, together = [], 0
    for begin, end in zip([0, *cuts], [*cuts, len(found)], strict=True):
        block = found[begin:end]
        while block:
            new = filtering.updates(block)
            together += len(new) if len(new) > 1 else 0
            told, block = [*told, *new], block[len(new) :]
    return told, together


def bits(told):
    """All numbers of estimates as bytes."""
    numbers = []
    for one in told:
        innovation = () if one.innovation is None else one.innovation
        parts = (one.mean, one.covariance, *innovation)
        numbers.append((one.outcome, one.time, one.replayed, *(part.numpy().tobytes() for part in parts)))
    return numbers


def kept(filtering):
    """All numbers of the window as bytes."""
    states = [filtering.window.anchor, *(entry.state for entry in filtering.window.entries)]
    numbers = [part.numpy().tobytes() for state in states for part in (*state.belief, *state[1:])]
    inner = [bits_of(entry.innovation) for entry in filtering.window.entries]
    return filtering.window.since, [entry.reading for entry in filtering.window.entries], numbers, inner


def bits_of(innovation):
    return [part.numpy().tobytes() for part in innovation]


@settings(max_examples=25)
@given(
    st.integers(0, 5),
    st.lists(st.integers(0, 70), max_size=6).map(sorted),
    st.sampled_from([0.0, 0.7, 100.0]),
    st.sampled_from([3, 1000]),
    st.sampled_from([None, Gate(0.9999, 50), Gate(0.9999, 2, reopens=True)]),
)
def test_blocks_of_any_size_give_the_bits_of_single_steps(seed, cuts, window, lines, gate):
    found = ruled(60, seed) if seed % 2 else readings(60, seed)
    options = {"window": window, "lines": lines, "gate": gate}
    ours, single = make(**options), make(**options)
    told, together = followed(ours, found, cuts)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ReadingRuns, "followed", lambda *_: None)
        expected = [single.update(reading) for reading in found]
    assert bits(told) == bits(expected)
    assert repr(kept(ours)) == repr(kept(single))
    assert together > 10 or seed % 2 == 0 or len(cuts) > 4


def orbit(flow):
    """Filter of an orbit with position fixes."""
    q = torch.diag(torch.tensor([1e-3] * 3 + [1e-5] * 3, dtype=torch.float64) ** 2)
    process = online_process(UnscentedKalmanFilter(gate=Gate(0.9999)), flow, 60.0, q)
    start = initial_belief([[0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]], np.diag([1.0] * 3 + [1e-4] * 3))
    return Assimilation(process, {"gnss": StreamSensor.of(Position(), 0.1, MOLNIYA.space)}, start)


def test_a_flow_in_c_is_followed_with_the_bits_of_single_steps():
    flow, draw, found = exact_flow(MOLNIYA), np.random.default_rng(1), []
    x, now = torch.tensor([[0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]], dtype=torch.float64), 0.0
    for dt in draw.choice([0.3, 17.0, 60.0, 61.0, 400.0], 40).tolist():
        x, now = flow(x, dt), now + dt
        found.append(Reading(now, tuple((x[0, :3].numpy() + 0.1 * draw.normal(size=3)).tolist()), "gnss"))
    ours, single = orbit(flow), orbit(flow)
    told, together = followed(ours, found, [])
    assert together == len(found)
    assert isinstance(flow.as_compiled(), CompiledFlow)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ReadingRuns, "followed", lambda *_: None)
        expected = [single.update(reading) for reading in found]
    assert bits(told) == bits(expected)


class Pushed:
    """A body that a force of time pushes."""

    clock = 1

    def at(self, time):
        """Its flow from a time on."""
        return lambda x, dt: coast(x, dt) + 0.1 * dt * torch.sin(torch.as_tensor(float(time) + 0.5 * dt))


def test_forces_of_time_act_at_the_time_of_each_step():
    def filtering():
        process = online_process(UnscentedKalmanFilter(), Pushed(), STEP, Q)
        ruler = StreamSensor.of(Position(1, "m"), 0.1, SPACE)
        return Assimilation(process, {"ruler": ruler}, initial_belief([MEAN], P0))

    found = [one for one in ruled(40, 3) if abs(one.values[0]) < 30]
    ours, single = filtering(), filtering()
    told, together = followed(ours, found, [])
    assert together > 10
    assert bits(told) == bits([single.update(reading) for reading in found])


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_flow_that_fails_raises_at_its_reading(error):
    calls = [0]

    def flow(x, dt):
        calls[0] += 1
        if calls[0] >= 12:
            raise error("no more")
        return coast(x, dt)

    process = online_process(UnscentedKalmanFilter(), flow, STEP, Q)
    sensors = {"ruler": StreamSensor.of(Position(1, "m"), 0.1, SPACE)}
    filtering = Assimilation(process, sensors, initial_belief([MEAN], P0))
    found = [Reading(0.3 * k, (1.2 + 0.07 * k,), "ruler") for k in range(1, 30)]
    told, calls[0] = [], 1

    def take_all():
        while True:
            told.extend(filtering.updates(found[len(told) :]))

    with pytest.raises(error, match="no more"):
        take_all()
    assert len(told) == (10 if error is ValueError else 0)
    assert filtering.window.time == (told[-1].time if told else 0.0)
