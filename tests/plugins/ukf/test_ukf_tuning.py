"""The search of a filter's constants."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from ahnn.data.generate import generate
from ahnn.errors import UserError
from ahnn.evaluation.open_loop import exact_flow
from ahnn.integrators import INTEGRATORS
from ahnn.systems import MassSpring
from ahnn_plugins.ukf import SQUARE_ROOT, Position, UnscentedParameters, tuning
from ahnn_plugins.ukf.scenario import Filter, Problem, Setting, validation_problem
from ahnn_plugins.ukf.tuning import LOST, Tuning, objectives, tune, tuned_once

SYSTEM = MassSpring(name="spring", dt=0.01, steps=200)
WRONG = MassSpring(name="wrong", dt=0.01, steps=200, stiffness=5.05)
OPTIONS = Tuning(trials=25, trajectories=4, steps=100, batch=8, seed=0)


@pytest.fixture
def search() -> tuple[Filter, Setting, Problem]:
    setting = Setting(Position(1, "m"), torch.full((1,), 3e-4), SYSTEM.deviations(), 20, SQUARE_ROOT, None)
    arcs = validation_problem(setting, generate(SYSTEM, 4, seed=0), 4, 100, seed=0)
    q = 1e-9 * torch.eye(2, dtype=torch.float64)  # far too little for a wrong spring
    flow = exact_flow(WRONG, INTEGRATORS["rk4"])
    return Filter("wrong", flow, q, setting.measurement_noise, UnscentedParameters()), setting, arcs


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
    options = Tuning(trials=4, trajectories=4, steps=100, batch=4, seed=0)
    first = tuned_once(*search, options, path)
    chosen, setting, arcs = search
    other = chosen._replace(process_noise=2 * chosen.process_noise)
    with monkeypatch.context() as patch:
        patch.setattr(tuning, "tune", lambda *_: pytest.fail("searched again"))
        assert tuned_once(*search, options, path) == first
        with pytest.raises(pytest.fail.Exception, match="searched again"):
            tuned_once(other, setting, arcs, options, path)


def test_mistakes_are_named() -> None:
    with pytest.raises(UserError, match=r"tuning.batch: expected at least 1; received 0"):
        Tuning(trials=1, trajectories=1, steps=None, batch=0, seed=0)
