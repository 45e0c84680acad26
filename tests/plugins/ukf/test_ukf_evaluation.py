"""The evaluation plugin: from a case to rows, numbers and figures, through its YAML."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir

from ahnn.config import build_all
from ahnn.data.generate import generate
from ahnn.errors import UserError
from ahnn.evaluation import Case, Findings
from ahnn.evaluation.case import perturbations
from ahnn.evaluation.open_loop import exact_flow
from ahnn.evaluation.run import plain
from ahnn.integrators import INTEGRATORS
from ahnn.paths import conf_dir
from ahnn.systems import MassSpring, Molniya, System
from ahnn.types import Flow

RK4 = INTEGRATORS["rk4"]
SPRING = MassSpring(name="spring", dt=0.01, steps=200)
STIFFER = MassSpring(name="stiffer", dt=0.01, steps=200, stiffness=5.02)
ORBITS = Molniya(name="orbits", dt=60.0, steps=130)


@pytest.fixture
def make_case(tmp_path: Path) -> Callable[..., Case]:
    """Return a factory of cases on six trajectories of a system."""

    def make(system: System, flow: Flow) -> Case:
        test, validation = generate(system, 6, seed=1), generate(system, 4, seed=2)
        return Case(
            label="model",
            system=system,
            flow=flow,
            learned_energy=None,
            integrator=RK4,
            test=test,
            validation=validation,
            train=validation,
            perturbation=perturbations(system, 6, seed=0),
            folder=tmp_path,
        )

    return make


def run(case: Case, *overrides: str, group: str = "ukf") -> Findings:
    """Evaluate a case by the plugin that the YAML and some overrides describe."""
    changes = [f"++plugins.ukf.{override}" for override in overrides]
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = compose("train", [f"plugins={group}", "folder=.", *changes])
    return build_all(cfg.plugins, "plugins")["ukf"](case)


@pytest.fixture
def spring(make_case: Callable[..., Case]) -> Case:
    return make_case(SPRING, exact_flow(STIFFER, RK4))


def test_rows_numbers_arrays_and_figures(spring: Case) -> None:
    findings = run(spring)
    names = [f"{who} + UKF{when}" for who in ("model", "exact flow") for when in ("", ", 1st fix on")]
    assert {(row.name, row.start) for row in findings.rows} == {
        (name, start) for name in names for start in ("true", "perturbed")
    }
    assert all(torch.tensor(row.scores[:5]).isfinite().all() for row in findings.rows)
    assert [row.floor for row in findings.rows] == [False] * 4 + [True] * 4
    json.dumps(plain(findings.numbers), allow_nan=False)
    told = findings.numbers["filters"]["model + UKF"]["perturbed"]
    assert told["status"] == {"OK": 6, "NOT_FINITE": 0, "COLLAPSED": 0, "DIVERGED": 0}
    assert told["repairs"] == 0
    assert 0.5 < told["coverage"]["1_sigma"]["share"] <= 1.0
    assert findings.arrays["perturbed_start"].shape == spring.test.states.shape
    assert all(array.isfinite().all() for array in findings.arrays.values())
    assert set(findings.figures) == {"state", "error", "error_band", "consistency", "moving_average"}


def test_fitted_process_noise_makes_the_filter_consistent_and_better_than_none(make_case: Callable) -> None:
    system = MassSpring(name="spring", dt=0.01, steps=600)
    case = make_case(system, exact_flow(MassSpring(name="s", dt=0.01, steps=600, stiffness=5.05), RK4))
    findings = run(case)
    told = findings.numbers["filters"]["model + UKF"]["perturbed"]
    # Errors that repeat themselves need a Q tens of times that of independent ones.
    assert findings.numbers["process_noise"]["scale"] > 5
    assert 0.5 < told["nees"]["mean"] < 4.0
    from ahnn.evaluation.rollout import rollout

    alone = case.score(rollout(case.flow, case.starts()["perturbed"], 0.01, 601))
    assert told["whole_arc"]["position"] < 0.5 * alone.position


def test_same_measurements_for_every_model(spring: Case, make_case: Callable) -> None:
    other = make_case(SPRING, exact_flow(SPRING, RK4))
    rows = [run(case).rows[-1] for case in (spring, other)]
    assert rows[0].name == "exact flow + UKF, 1st fix on"
    assert rows[0].scores == rows[1].scores


def test_a_model_that_blows_up_ends_in_a_remark(make_case: Callable, tmp_path: Path) -> None:
    findings = run(make_case(SPRING, lambda x, dt: x * 1e40 * dt))
    row = findings.rows[0]
    assert row.note == "6 of 6 lost (not finite)"
    assert row.scores.position == float("inf")
    assert findings.numbers["filters"]["model + UKF"]["true"]["status"]["NOT_FINITE"] == 6
    assert findings.rows[-1].scores.position < 1e-3
    json.dumps(plain(findings.numbers), allow_nan=False)
    for name, figure in findings.figures.items():
        figure.savefig(tmp_path / f"{name}.png")


def test_smoother_has_its_own_rows_and_is_better(spring: Case) -> None:
    findings = run(spring, group="ukf_smoothed")
    scores = {(row.name, row.start): row.scores for row in findings.rows}
    for who in ("model", "exact flow"):
        smoothed, filtered = (scores[f"{who} + UKF{s}", "perturbed"].position for s in (" + RTS", ""))
        assert smoothed < filtered


def test_ground_station_from_yaml(make_case: Callable) -> None:
    case = make_case(ORBITS, exact_flow(ORBITS, RK4))
    station = "{_target_:ahnn_plugins.ukf.stations.GroundStation,latitude:60,longitude:30,range_rate:true}"
    findings = run(case, f"measurement={station}", "measurement_sd=[0.1,1e-4,1e-4,1e-5]", "cadence=10")
    assert findings.numbers["measured"] == ["range", "azimuth", "elevation", "range_rate"]
    assert findings.rows[3].scores.position < 3.0  # km; without measurements tens of km


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("cadence=0", "cadence: expected at least 1"),
        ("cadence=201", "cadence: expected at most 200, the steps of a trajectory; received 201"),
        ("cadence=fast", "cadence: expected int; received 'fast'"),
        ("process_noise=[1.0]", "process_noise: expected `fitted` or two"),
        ("process_noise=guessed", "process_noise: expected one of fitted or a list of float"),
        ("measurement_sd=[1.0,2.0]", r"measurement_sd: expected one number > 0 for each of q1 \[m\]"),
        ("measurement={latitude:3}", "measurement: expected null or a node with _target_; received keys lat"),
        ("gate=1.5", r"gate: expected a probability in \(0, 1\)"),
        ("kappa=-2.0", "expected alpha other than 0 and kappa > -2"),
        ("tuning={trial:3}", "tuning: unknown key 'trial'; did you mean 'trials'"),
    ],
)
def test_mistakes_are_named(spring: Case, change: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        run(spring, change)


def test_a_measurement_of_another_system_is_refused(spring: Case) -> None:
    station = "{_target_:ahnn_plugins.ukf.stations.GroundStation,latitude:60,longitude:30}"
    with pytest.raises(UserError, match="states with 2 components; GroundStation failed"):
        run(spring, f"measurement={station}", "measurement_sd=1.0")
