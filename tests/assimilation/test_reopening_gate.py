"""A gate that opens again: outliers, a manoeuvre, a filter that has lost its object, a sensor that lies."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from fleet import fleet, table
from following import MEAN, P0, SENSORS, STEP, Q, coast, make, session

from ahnn.assimilation import Assimilation, Reading
from ahnn.assimilation.unit_mistakes import in_wrong_unit
from ahnn.errors import TrainingError
from ahnn.estimation import Gate, initial_belief
from ahnn.estimation.online import online_process
from ahnn.estimation.reopening import widened
from ahnn_plugins.ekf import ExtendedKalmanFilter
from ahnn_plugins.enkf import EnsembleKalmanFilter
from ahnn_plugins.imm import InteractingModels
from ahnn_plugins.particle import ParticleFilter
from ahnn_plugins.ukf import UnscentedKalmanFilter

GATE = Gate(0.999999, 5, reopens=True)
TIMES = np.arange(1, 41) * STEP


def fixes(positions, times=TIMES, seed=0):
    """Readings of the ruler about true positions."""
    noise = np.random.default_rng(seed).normal(size=len(times)) * 0.1
    pairs = zip(times.tolist(), (positions + noise).tolist(), strict=True)
    return [Reading(time, (value,), "ruler") for time, value in pairs]


def manoeuvre(speed, at=10.0):
    """True positions of a body that has another speed from a time on, and those at the end."""
    position = 1.0 + 0.3 * TIMES + (speed - 0.3) * np.maximum(TIMES - at, 0)
    return position, [position[-1], speed]


def outcomes(filtering, found):
    return [filtering.update(one).outcome for one in found]


def errors(filtering, truth):
    """Errors of the estimate in its standard deviations."""
    belief = filtering.window.state.moments
    return ((belief.mean[0] - torch.tensor(truth)) / belief.chol[0].norm(dim=-1)).abs().tolist()


def test_outliers_are_as_if_they_had_not_been_there():
    found = fixes(1.0 + 0.3 * TIMES)
    spoiled = [
        one._replace(values=(one.values[0] + 50.0,)) if k % 8 > 4 else one for k, one in enumerate(found)
    ]
    gated, clean = make(gate=GATE), make()
    told = outcomes(gated, spoiled)
    assert [k for k, word in enumerate(told) if word == "rejected"] == [k for k in range(40) if k % 8 > 4]
    for k, one in enumerate(found):
        clean.update(one if k % 8 <= 4 else one._replace(values=(np.nan,)))
    ours, theirs = gated.window.state.belief, clean.window.state.belief
    assert torch.equal(ours.mean, theirs.mean)
    assert torch.equal(ours.chol, theirs.chol)


@pytest.mark.parametrize("speed", [8.0, -300.0])
def test_a_manoeuvre_is_followed_after_as_many_refusals_as_it_has_patience_for(speed):
    positions, truth = manoeuvre(speed)
    filtering = make(gate=GATE)
    told = outcomes(filtering, fixes(positions))
    assert told.count("reopened") == 1
    first = told.index("rejected")
    assert told[first : first + 5] == ["rejected"] * 4 + ["reopened"]
    assert {*told[first + 5 :]} == {"taken"}
    assert max(errors(filtering, truth)) < 4


ESTIMATORS = {
    "ukf": UnscentedKalmanFilter(),
    "ekf": ExtendedKalmanFilter(),
    "enkf": EnsembleKalmanFilter(ensemble=60),
    "particle": ParticleFilter(particles=300),
    "imm": InteractingModels(filter=UnscentedKalmanFilter()),
}


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.sampled(3)
def test_a_filter_far_off_finds_its_object(name):
    far = 1e3 if name == "particle" else 1e6
    process = online_process(ESTIMATORS[name].gated(GATE), coast, STEP, Q)
    filtering = Assimilation(process, SENSORS, initial_belief([MEAN], P0))
    told = outcomes(filtering, fixes(far + 0.005 * far * TIMES))
    assert told[:5] == ["rejected"] * 4 + ["reopened"]
    assert told[-20:] == ["taken"] * 20
    assert max(errors(filtering, [far + 0.005 * far * TIMES[-1], 0.005 * far])) < 5


def test_what_no_covariance_explains_stays_refused():
    absurd = [Reading(0.5 * k, (1e12,), "ruler") for k in range(1, 9)]
    filtering = make(gate=GATE)
    assert outcomes(filtering, absurd) == ["rejected"] * 8
    assert outcomes(filtering, [Reading(5.0, (2.5,), "ruler")]) == ["taken"]


def test_a_sensor_that_lies_between_good_ones_opens_nothing():
    good = fixes(1.0 + 0.3 * TIMES)
    lies = [Reading(one.time, (90.0, 7.0), "radar") for one in good]
    told = outcomes(make(gate=GATE), [one for pair in zip(good, lies, strict=True) for one in pair])
    assert told == ["taken", "rejected"] * 40


def test_the_covariance_of_the_start_comes_on_top():
    filtering = make(gate=GATE)
    outcomes(filtering, fixes(1.0 + 0.3 * TIMES))
    state, spread = filtering.window.state, filtering.spread
    wide = widened(filtering.process.estimator, state, spread, torch.tensor([7.0], dtype=torch.float64))
    expected = state.belief.covariance[0] + 7.0 * torch.from_numpy(P0)
    torch.testing.assert_close(wide.belief.covariance[0], expected, rtol=1e-12, atol=0)
    assert wide.steps == state.steps
    assert wide.log_likelihood == state.log_likelihood


@pytest.mark.parametrize("window", [0.0, 2.0])
def test_many_objects_reopen_as_each_alone(window):
    options = {"gate": GATE, "window": window}
    speeds = {"body 0": 0.3, "body 1": 8.0, "body 2": -300.0, "body 3": 9.0}
    own = {name: fixes(manoeuvre(speed)[0], seed=k) for k, (name, speed) in enumerate(speeds.items())}
    late = window > 0
    for found in own.values():
        if late:
            found[25:27] = reversed(found[25:27])
    catalogue = fleet([*speeds], **options)
    pairs = [(name, own[name][k]) for k in range(len(TIMES)) for name in own]
    told = catalogue.update(table(pairs))
    for k, found in enumerate(own.values()):
        process = online_process(UnscentedKalmanFilter(gate=GATE), coast, STEP, Q)
        start = initial_belief([np.array(MEAN) + k * np.array([0.05, 0.01])], P0)
        alone = Assimilation(process, SENSORS, start, window=window)
        assert outcomes(alone, found) == told.outcomes[k :: len(own)]
        _, beliefs = catalogue.beliefs()
        mean = alone.window.state.belief.mean[0]
        torch.testing.assert_close(beliefs.mean[k], mean, rtol=1e-12, atol=1e-12)
    words = zip(told.outcomes, pairs, strict=True)
    assert {name for word, (name, _) in words if word == "reopened"} == {"body 1", "body 2", "body 3"}
    assert not catalogue.lost


def test_a_stream_says_it_and_goes_on_bit_for_bit_from_the_middle_of_the_refusals(tmp_path, caplog):
    caplog.set_level("INFO", "ahnn")
    found = fixes(manoeuvre(8.0)[0])
    lines = ["time,sensor,q,p", *(f"{one.time!r},ruler,{one.values[0]!r}," for one in found)]
    whole, parts = tmp_path / "whole.csv", tmp_path / "parts.csv"
    first = session("\n".join(lines) + "\n", whole, gate=GATE)
    first.run()
    assert "line 26: time 12.5 from sensor ruler reopened the gate" in caplog.text
    assert ",reopened," in whole.read_text().splitlines()[25]
    assert "% of the measurements, and reopened once" in first.verdict()
    for end in (24, 25, 26, 41):  # before, within and behind
        session("\n".join(lines[:end]) + "\n", parts, tmp_path / "state", every=1, gate=GATE).run()
    assert parts.read_bytes() == whole.read_bytes()


@pytest.mark.parametrize("factor", [1e3, 1e-3])
def test_values_in_a_wrong_unit_open_nothing(tmp_path, factor):
    right = fixes(200.0 + 0.3 * TIMES)
    wrong = [one._replace(values=(factor * one.values[0],)) for one in right[8:]]
    far = {"gate": GATE, "mean": [200.0, 0.3]}
    told = outcomes(make(**far), [*right[:8], *wrong])
    assert told == ["taken"] * 8 + ["rejected"] * 32
    lines = ["time,sensor,q,p", *(f"{one.time!r},ruler,{one.values[0]!r}," for one in [*right[:8], *wrong])]
    whole = session("\n".join(lines) + "\n", tmp_path / "a.csv", **far)
    whole.run()
    with pytest.raises(TrainingError, match=r"about \S*1000 times the predicted value: is the unit right"):
        whole.require_followed()
    lines[30] = "15.0,ruler,5e4,"  # no such factor
    with pytest.raises(TrainingError, match=r"line 31: expected measurements near the estimates.*unit right"):
        session("\n".join(lines) + "\n", tmp_path / "b.csv", **far).run()


def test_a_wrong_unit_is_that_of_most_components_or_of_all_that_differ():
    predicted = torch.tensor([[2.0, -3.0, 1e-6]], dtype=torch.float64)
    nan = torch.nan
    for factors, expected in (
        ([1e3, 1.1e3, 0.9e3], True),
        ([1e-3, 1e-3, 40.0], True),  # one near zero
        ([1e3, 1.0, 1.0], True),  # a range with its angles
        ([1e3, 5.0, 1.0], False),
        ([1.0, 1.0, 1.0], False),
        ([3e3, 3e3, 3e3], False),
        ([1e3, nan, nan], True),
        ([nan, nan, nan], False),
    ):
        measured = predicted * torch.tensor(factors, dtype=torch.float64)
        assert in_wrong_unit(measured, predicted).tolist() == [expected], factors
