"""The evaluation plugin: from a case to rows, numbers and figures, through its YAML."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from evaluating import run
from scipy.stats import chi2

from ahnn.errors import UserError
from ahnn.estimation import Setting, simulated
from ahnn.evaluation import Case, Findings, Who
from ahnn.evaluation.open_loop import Integrated
from ahnn.evaluation.results import plain
from ahnn.integrators import INTEGRATORS
from ahnn.measurements import Position
from ahnn.systems import MassSpring, Molniya

RK4 = INTEGRATORS["rk4"]
SPRING = MassSpring(name="spring", dt=0.01, steps=200)
STIFFER = MassSpring(name="stiffer", dt=0.01, steps=200, stiffness=5.02)
ORBITS = Molniya(name="orbits", dt=60.0, steps=130)


@pytest.fixture(scope="module")
def spring(make_case: Callable[..., Case]) -> Case:
    return make_case(SPRING, Integrated(STIFFER, RK4))


@pytest.fixture(scope="module")
def found(spring: Case) -> Findings:
    """What the default options find on the spring."""
    return run(spring)


def test_rows_numbers_arrays_and_figures(spring: Case, found: Findings) -> None:
    findings = found  # by the default options
    assert {row.who for row in findings.rows} == {
        Who(process, start, "ukf", span, process == "exact flow")
        for process in ("model", "exact flow")
        for start in ("true", "perturbed")
        for span in ("whole", "settled")
    }
    assert all(torch.tensor(row.scores[:5]).isfinite().all() for row in findings.rows)
    json.dumps(plain(findings.numbers), allow_nan=False)
    told = findings.numbers["filters"]["ukf"]["model"]["perturbed"]
    assert told["status"] == {"OK": 6, "NOT_FINITE": 0, "COLLAPSED": 0, "DIVERGED": 0, "IMPRECISE": 0}
    assert told["repairs"] == 0
    assert 0.5 < told["coverage"]["1_sigma"]["fraction"] <= 1.0
    assert findings.arrays["perturbed_start"].shape == spring.test.states.shape
    assert all(array.isfinite().all() for array in findings.arrays.values())
    teeth = {key: findings.arrays[f"perturbed_sawtooth_{key}"] for key in ("mean", "deviation", "member")}
    assert teeth["member"].tolist() == [0]
    assert torch.equal(teeth["mean"][::2], findings.arrays["perturbed_start"][0])  # after the updates
    jumps = (teeth["deviation"][1::2] != teeth["deviation"][2::2]).any(-1)
    assert (jumps.nonzero().flatten() + 1).tolist() == findings.numbers["updates"]
    assert set(findings.figures) == {"state", "error", "error_band", "consistency", "moving_average"}


@pytest.mark.slow
def test_fitted_process_noise_makes_the_filter_consistent_and_better_than_none(make_case: Callable) -> None:
    system = MassSpring(name="spring", dt=0.01, steps=600)
    case = make_case(system, Integrated(MassSpring(name="s", dt=0.01, steps=600, stiffness=5.05), RK4))
    findings = run(case)
    told = findings.numbers["filters"]["ukf"]["model"]["perturbed"]
    # Errors that repeat themselves need a Q tens of times that of independent ones.
    assert findings.numbers["process_noise"]["scale"] > 5
    assert 0.5 < told["nees"]["mean"] < 4.0
    from ahnn.rollouts import rollout

    alone = case.score(rollout(case.flow, case.starts()["perturbed"], 0.01, 601))
    assert told["whole_arc"]["position"] < 0.5 * alone.position


def test_a_force_error_is_fitted_or_given(spring: Case) -> None:
    findings = run(spring, "process_noise=force_error")
    noise = findings.numbers["process_noise"]
    # The stiffness, and so the force, is off by 0.4 % for good.
    assert noise["size"] / noise["scale"] ** 0.5 == pytest.approx(0.004, rel=0.02)
    assert noise["memory"] > 10 * SPRING.dt
    told = findings.numbers["filters"]["ukf"]["model"]["perturbed"]
    assert told["status"]["OK"] == 6
    assert 0.5 < told["nees"]["mean"] < 4.0
    assert findings.arrays["perturbed_start"].shape == spring.test.states.shape
    given = run(spring, "process_noise={size:0.01,memory:3.0}").numbers["process_noise"]
    told = {"size": 0.01, "memory": 3.0, "scale": 1.0, "nees_of_scales": [], "novelty": None}
    assert given == {"from": "force_error", **told}


@pytest.mark.slow
def test_parameters_without_covariance_have_a_force_error_in_their_place(
    spring: Case, caplog: pytest.LogCaptureFixture
) -> None:
    found, asked = (run(spring, f"process_noise={n}").numbers for n in ("parameter_error", "force_error"))
    assert found["process_noise"] == asked["process_noise"]
    assert found["filters"] == asked["filters"]
    assert "so force_error is used" in caplog.text


@pytest.mark.usefixtures("no_figures")
def test_same_measurements_for_every_model(found: Findings, make_case: Callable) -> None:
    other = run(make_case(SPRING, Integrated(SPRING, RK4)))
    floor = Who("exact flow", "perturbed", "ukf", "settled", floor=True)
    rows = [next(row for row in one.rows if row.who == floor) for one in (found, other)]
    assert rows[0].scores == rows[1].scores


def test_a_model_that_blows_up_ends_in_a_remark(make_case: Callable, tmp_path: Path) -> None:
    findings = run(make_case(SPRING, lambda x, dt: x * 1e40 * dt))
    row = findings.rows[0]
    assert row.note == "6 of 6 lost (not finite)"
    assert row.scores.position == float("inf")
    assert findings.numbers["filters"]["ukf"]["model"]["true"]["status"]["NOT_FINITE"] == 6
    assert findings.rows[-1].scores.position < 1e-3
    json.dumps(plain(findings.numbers), allow_nan=False)
    for name, figure in findings.figures.items():
        figure.savefig(tmp_path / f"{name}.png")


@pytest.mark.usefixtures("no_figures")
def test_smoother_has_its_own_rows_and_is_better(spring: Case) -> None:
    findings = run(spring, group="ukf_smoothed")
    scores = {row.who: row.scores for row in findings.rows}
    for process in ("model", "exact flow"):
        who = Who(process, "perturbed", "ukf", floor=process == "exact flow")
        assert scores[who._replace(estimator="ukf_smoothed")].position < scores[who].position


@pytest.mark.slow
def test_estimators_of_whole_arcs_have_their_own_rows(make_case: Callable) -> None:
    short = make_case(dataclasses.replace(SPRING, steps=80), Integrated(STIFFER, RK4))
    findings = run(short, "least_squares=true", group="ukf_iterated")
    named = {"ukf", "ukf_smoothed", "ukf_iterated", "batch_least_squares"}
    assert {row.who.estimator for row in findings.rows} == named
    told = findings.numbers["filters"]
    assert told["ukf_iterated"]["floor"]["true"]["unsettled"] == 0
    fit = told["batch_least_squares"]["floor"]["perturbed"]
    assert fit["unsettled"] == 0
    assert 0.3 < fit["chi_square_per_number"] < 2.0
    # A spring is linear: without process noise all three are one.
    smoothed, *others = (told[name]["floor"]["perturbed"] for name in told if name != "ukf")
    for other in others:
        assert other["whole_arc"]["position"] == pytest.approx(smoothed["whole_arc"]["position"], rel=1e-3)
    json.dumps(plain(findings.numbers), allow_nan=False)
    alone = run(short, group="batch_least_squares")
    assert {row.who.estimator for row in alone.rows} == {"ukf", "batch_least_squares"}
    note = next(row.note for row in alone.rows if row.who.estimator != "ukf" and row.who.span == "settled")
    assert "NEES" in note
    assert "NIS" not in note


@pytest.mark.usefixtures("no_figures")
def test_ground_station_from_yaml(make_case: Callable) -> None:
    case = make_case(ORBITS, Integrated(ORBITS, RK4))
    findings = run(case, "cadence=10", measurement="ground_station")
    assert findings.numbers["measured"] == ["range", "azimuth", "elevation", "range_rate"]
    assert findings.rows[3].scores.position < 3.0  # km; without measurements tens of km


@pytest.mark.usefixtures("no_figures")
def test_a_filter_that_measured_nothing_says_so(make_case: Callable) -> None:
    # Nothing of these orbits stands in the zenith of the pole.
    case = make_case(ORBITS, Integrated(ORBITS, RK4))
    station = "{_target_:ahnn.measurements.GroundStation,latitude:-90,longitude:0,min_elevation:89}"
    findings = run(case, "cadence=10", f"measurement={station}", "measurement_sd=1e-3")
    for row in findings.rows:
        text = "nothing was measured" if row.who.span == "settled" else "6 of 6 without any measurement"
        assert text in row.note
    json.dumps(plain(findings.numbers), allow_nan=False)


def test_the_consistency_is_judged_by_the_band_of_what_is_averaged(found: Findings) -> None:
    told = found.numbers["filters"]["ukf"]["floor"]["perturbed"]
    rows, degrees = 6 * 3, 1
    low, high = (chi2.ppf(p, rows * degrees) / rows for p in (0.025, 0.975))
    assert told["nis"]["band_95"] == pytest.approx([low, high])
    # The error of a spring without process noise lasts: many times count little more than one.
    narrow, wide = told["nees"]["band_95"], told["nees"]["one_time_band_95"]
    assert wide[0] <= narrow[0] < narrow[1] <= wide[1]
    assert narrow[1] - narrow[0] > 0.3 * (wide[1] - wide[0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("cadence=0", "cadence: expected int >= 1"),
        ("cadence=201", "cadence: expected at most 200, the number of steps of a trajectory; received 201"),
        ("times=[0.1,0.3,0.2]", "times: expected increasing multiples of dt = 0.01, from 0.01 to 2"),
        ("times=[0.105]", r"times: expected increasing multiples .* received \[0.105\]"),
        ("times=[0.0]", "times: expected increasing multiples"),
        ("times=[]", "times: expected increasing multiples"),
        ("start_sd=[1.0]", "start_sd: expected 2 numbers > 0"),
        ("measurement_sd=nan", "measurement_sd: expected a list of float > 0 or float > 0 or None"),
        ("alpha=nan", r"alpha: expected float \(finite\); received nan"),
        ("patience=0", "patience: expected int >= 1; received 0"),
        ("measurement=velocity", "measurement: expected .* position, state"),
        ("measurement={_target_:ahnn.estimation.Gate}", "Gate has no names, units, __call__"),
        ("cadence=fast", "cadence: expected int >= 1; received 'fast'"),
        ("process_noise=[1.0]", "process_noise: expected .*fitted, force_error"),
        ("process_noise=guessed", "process_noise: expected .*fitted, force_error"),
        ("process_noise={size:-1.0}", "process_noise.size: expected float > 0"),
        ("process_noise={tau:1.0}", "process_noise: unknown key 'tau'"),
        ("measurement_sd=[1.0,2.0]", "measurement_sd: expected a standard deviation > 0 for each of q .m."),
        (
            "measurement={latitude:3}",
            "measurement: expected position, state or a node with _target_; received keys",
        ),
        ("gate=1.5", "gate: expected float > 0 and < 1 or None; received 1.5"),
        ("kappa=-2.0", "choose alpha != 0 and kappa > -L"),
        ("smoother=twice", "smoother: expected .*iterated"),
        ("tuning={trial:3}", "tuning: unknown key 'trial'; did you mean 'trials'"),
    ],
)
def test_mistakes_are_named(spring: Case, change: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        run(spring, change)


@pytest.mark.usefixtures("no_figures")
def test_measurements_at_given_times(spring: Case) -> None:
    findings = run(spring, "times=[0.3,0.5,1.7]")
    assert findings.numbers["updates"] == [30, 50, 170]
    told = findings.numbers["filters"]["ukf"]["model"]["true"]["moving_average_240"]
    assert told["sample"] == [30, 50, 170]
    assert all(value > 0 for value in told["position"])


@pytest.mark.usefixtures("no_figures")
def test_satellites_and_whole_states_are_measured_from_yaml(make_case: Callable[..., Case]) -> None:
    case = make_case(ORBITS, Integrated(ORBITS, RK4))
    ranges = run(case, "cadence=10", measurement="gnss_range")
    states = run(case, "cadence=10", "measurement_sd=[1,1,1,1e-3,1e-3,1e-3]", measurement="state")
    assert len(ranges.numbers["measured"]) == 4
    assert len(states.numbers["measured"]) == 6
    assert ranges.rows[3].scores.position < 1.0
    assert states.rows[3].scores.position < 3.0


def test_measurement_noise_is_not_the_initial_error(spring: Case) -> None:
    setting = Setting(Position(1, "m"), torch.ones(1), SPRING.deviations(), (1, 2))
    noise = simulated(setting, torch.zeros(6, 3, 2, dtype=torch.float64), 0.01, seed=0).flatten()
    start = (spring.perturbation / SPRING.deviations()).flatten()
    assert not torch.isclose(noise[:, None], start).any()


@pytest.mark.usefixtures("no_figures")
def test_a_filter_that_spoils_the_velocity_alone_says_so(make_case: Callable[..., Case]) -> None:
    case = make_case(SPRING, Integrated(SPRING, RK4))
    findings = run(case, "process_noise=[0.0,5e-5]")
    row = next(row for row in findings.rows if row.who.start == "perturbed")
    assert row.note == "worse than no filter in velocity: the model or its process noise"


def test_a_station_that_would_read_momenta_as_velocities_is_refused(make_case: Callable[..., Case]) -> None:
    heavy = Molniya(name="heavy", dt=60.0, steps=130, mass=2.0)
    with pytest.raises(UserError, match=r"GroundStation with mass=2, .* received mass=1"):
        run(make_case(heavy, Integrated(heavy, RK4)), "cadence=10", measurement="ground_station")


def test_a_measurement_of_another_system_is_refused(spring: Case) -> None:
    with pytest.raises(UserError, match="states with 2 components; GroundStation failed"):
        run(spring, measurement="ground_station")


def test_without_a_perturbed_start_the_true_one_is_filtered_and_drawn(spring: Case, tmp_path: Path) -> None:
    findings = run(dataclasses.replace(spring, perturbation=None))
    assert {row.who.start for row in findings.rows} == {"true"}
    assert set(findings.figures) == {"state", "error", "error_band", "consistency", "moving_average"}
    for name, figure in findings.figures.items():
        figure.savefig(tmp_path / f"{name}.png")


def test_data_without_equations_are_refused(spring: Case) -> None:
    with pytest.raises(
        UserError, match="system: expected a system with known equations; received data for spring"
    ):
        run(dataclasses.replace(spring, truth=None))
