"""The search of a filter's constants."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from unittest.mock import MagicMock

import pytest
import torch

from ahnn import progress
from ahnn.data.generate import generate
from ahnn.errors import UserError
from ahnn.estimation import Problem, Setting, perturbed_arcs
from ahnn.estimation.trial import Filter
from ahnn.evaluation.open_loop import Integrated
from ahnn.integrators import INTEGRATORS
from ahnn.measurements import Position
from ahnn.systems import MassSpring
from ahnn_plugins.ukf import UnscentedKalmanFilter, UnscentedParameters, tuning
from ahnn_plugins.ukf.tuning import LOST, Tuning, objectives, tune, tuned_once

SYSTEM = MassSpring(name="spring", dt=0.01, steps=200)
WRONG = MassSpring(name="wrong", dt=0.01, steps=200, stiffness=5.05)
RANGES = {
    "alpha": [1e-3, 1.0],
    "beta": [0.0, 4.0],
    "kappa": [0.0, 3.0],
    "scale_q": [1e-2, 1e2],
    "scale_r": [0.1, 10.0],
}
OPTIONS = Tuning(ranges=RANGES, trials=25, trajectories=4, steps=100, batch=8, seed=0)


@pytest.fixture
def search() -> tuple[Filter, Setting, Problem]:
    updates = tuple(range(20, 101, 20))
    sd = torch.full((1,), 3e-4)
    setting = Setting(Position(1, "m"), sd, SYSTEM.deviations(), updates)
    arcs = perturbed_arcs(setting, generate(SYSTEM, 4, seed=0).states, SYSTEM.dt, 4, 100, seed=0)
    q = 1e-9 * torch.eye(2, dtype=torch.float64)  # far too little for a wrong spring
    flow = Integrated(WRONG, INTEGRATORS["rk4"])
    return Filter("wrong", flow, q, setting.measurement_noise, UnscentedKalmanFilter()), setting, arcs


def test_search_is_better_than_its_start_and_reproducible(search: tuple) -> None:
    first, second = tune(*search, OPTIONS), tune(*search, OPTIONS)
    assert first == second
    assert first.objective < 0.98 * first.untuned
    chosen, setting, arcs = search
    plain = dict.fromkeys(first.values, 1.0) | {"beta": 2.0, "kappa": 0.0}
    assert objectives(chosen, setting, arcs, [plain]) == pytest.approx([first.untuned], rel=1e-12)
    assert objectives(first.apply(chosen), setting, arcs, [{**first.values, "scale_q": 1, "scale_r": 1}]) == (
        pytest.approx([first.objective], rel=1e-6)  # small alpha amplifies rounding
    )


def test_trials_of_a_batch_do_not_touch_each_other(search: tuple) -> None:
    trials = [
        {"alpha": a, "beta": 2.0, "kappa": 0.5, "scale_q": q, "scale_r": 2.0} for a, q in ((1, 1), (0.1, 9))
    ]
    together = objectives(*search, trials)
    assert together == [objectives(*search, [trial])[0] for trial in trials]


def test_a_trial_that_loses_a_member_gets_a_finite_penalty(search: tuple) -> None:
    chosen, setting, arcs = search
    trial = {"alpha": 1.0, "beta": 2.0, "kappa": 0.0, "scale_q": 1.0, "scale_r": 1.0}
    broken = chosen._replace(flow=lambda x, dt: x * 1e60 * dt)
    assert objectives(broken, setting, arcs, [trial, trial]) == [LOST, LOST]


def test_values_are_stored_and_used_again(
    search: tuple, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "ukf_tuned.json"
    options = Tuning(ranges=RANGES, trials=4, trajectories=4, steps=100, batch=4, seed=0)
    first = tuned_once(*search, options, path)
    chosen, setting, arcs = search
    other = chosen._replace(process_noise=2 * chosen.process_noise)
    with monkeypatch.context() as patch:
        patch.setattr(tuning, "tune", lambda *_: pytest.fail("searched again"))
        assert tuned_once(*search, options, path) == first
        with pytest.raises(pytest.fail.Exception, match="searched again"):
            tuned_once(other, setting, arcs, options, path)
        with pytest.raises(pytest.fail.Exception, match="searched again"):
            tuned_once(chosen, setting, arcs._replace(measurements=2 * arcs.measurements), options, path)
    path.write_text("{")
    assert tuned_once(*search, options, path) == first
    assert path.read_text() == "{"  # as somebody has left it


def test_only_what_has_a_range_is_searched(search: tuple) -> None:
    only_q = Tuning(ranges={"scale_q": [1e-2, 1e2]}, trials=6, trajectories=4, steps=100, batch=6, seed=0)
    found = tune(*search, only_q)
    assert set(found.values) == {"scale_q"}
    assert found.apply(search[0]).estimator == search[0].estimator
    assert found.objective < found.untuned


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"batch": 0}, "batch: expected int >= 1; received 0"),
        ({"ranges": {"alfa": [0, 1]}}, "ranges: unknown key 'alfa'; did you mean 'alpha'"),
        (
            {"ranges": {"alpha": [0.0, 1.0]}},
            r"ranges.alpha: expected a range \[low, high\] .* > 0",
        ),
        ({"ranges": {"kappa": [2.0, 1.0]}}, r"ranges.kappa: expected a range \[low, high\] .* low <= high"),
        ({"ranges": {"kappa": "wide"}}, "ranges.kappa: expected .* received 'wide'"),
    ],
)
def test_mistakes_are_named(change: dict, message: str) -> None:
    options = {"ranges": RANGES, "trials": 1, "trajectories": 1, "steps": None, "batch": 1, "seed": 0}
    with pytest.raises(UserError, match=message):
        Tuning(**{**options, **change})


def test_a_range_that_the_search_cannot_begin_in_is_refused(search: tuple) -> None:
    away = Tuning(ranges={"alpha": [1e-3, 0.5]}, trials=2, trajectories=4, steps=100, batch=2, seed=0)
    with pytest.raises(UserError, match="contains the untuned 1, at"):
        tune(*search, away)


@pytest.mark.parametrize(("trials", "batch", "sizes"), [(7, 3, [3, 3, 1]), (6, 3, [3, 3]), (2, 5, [2])])
def test_as_many_trials_as_asked_for_are_filtered_in_batches(search, monkeypatch, trials, batch, sizes):
    asked = []

    def counted(*arguments):
        some = arguments[-1]
        asked.append(len(some))
        return [float(trial["scale_q"]) for trial in some]

    monkeypatch.setattr(tuning, "objectives", counted)
    options = Tuning({"scale_q": [1e-2, 1e2]}, trials, trajectories=4, steps=100, batch=batch, seed=0)
    found = tune(*search, options)
    assert asked == sizes
    assert found.untuned == 1.0
    assert found.objective == found.values["scale_q"] <= 1.0


def test_the_bar_is_full_when_all_is_tried(search, monkeypatch):
    bar, told = MagicMock(), []
    bar.__enter__.return_value = bar
    bar.add_task.side_effect = lambda _, total: told.append(total)
    bar.disable = False
    monkeypatch.setattr(progress, "progress_bar", lambda: bar)
    tune(*search, dataclasses.replace(OPTIONS, trials=5, batch=2))
    assert told == [bar.advance.call_count] == [3 * 100]


def test_the_objective_is_in_initial_deviations_from_the_first_update_on(search):
    chosen, setting, arcs = search
    (got,) = objectives(chosen, setting, arcs, [{}])
    result = tuning.assimilate(chosen, setting, arcs)
    error = (result.means - arcs.truth[:, 1:])[:, 19:] / setting.start_sd
    rms = error.square().mean(1).sqrt().mean(0)
    assert got == pytest.approx(float(rms.sum()), rel=1e-9)
    (doubled,) = objectives(chosen, setting, arcs, [{"scale_q": 2.0, "scale_r": 4.0, "alpha": 0.5}])
    other = chosen._replace(
        process_noise=2.0 * chosen.process_noise,
        measurement_noise=4.0 * chosen.measurement_noise,
        estimator=UnscentedKalmanFilter(UnscentedParameters(alpha=0.5)),
    )
    assert doubled == pytest.approx(objectives(other, setting, arcs, [{}])[0], rel=1e-9)


def test_the_smallest_search_is_one_trial_of_one_step():
    one = Tuning({}, trials=1, trajectories=1, steps=1, batch=1, seed=0)
    assert one.space() == {}
    for name in ("trials", "trajectories", "steps", "batch"):
        with pytest.raises(UserError, match=f"{name}: expected int >= 1"):
            Tuning(**{**vars(one), name: -1})
