"""Rollouts and floors against numbers computed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from cases import MODEL, ORBITS, RK4, SPRING, STIFFER, drop, make_case

from ahnn.evaluation import Findings, Row, Who, evaluate
from ahnn.evaluation.open_loop import Integrated, floors, open_loop
from ahnn.metrics import moving_average, score

FIELDS = ("position", "velocity", "position_pooled", "velocity_pooled", "energy")


def by_who(findings):
    return {row.who: row for row in findings.rows}


def steps_by_hand(flow, x, count):
    states = [x]
    for _ in range(count):
        states.append(flow(states[-1], SPRING.dt))
    return torch.stack(states, dim=1)


def test_the_rows_of_a_case_and_their_scores_by_hand(tmp_path):
    case = make_case(tmp_path)
    rows = by_who(open_loop(case))
    exact = Who("exact field, rk4", "true", floor=True), Who("exact flow", "perturbed", floor=True)
    assert set(rows) == {MODEL, MODEL._replace(start="perturbed"), *exact}
    prediction = steps_by_hand(Integrated(STIFFER, RK4), case.test.states[:, 0], SPRING.steps)
    off = (prediction - case.test.states).numpy()
    scores = rows[MODEL].scores
    position = np.mean(np.sqrt(np.mean(off[:, :, 0] ** 2, axis=1)))
    assert scores.position == pytest.approx(position, rel=1e-12)
    assert scores.velocity_pooled == pytest.approx(np.sqrt(np.mean((off[..., 1] / 2.0) ** 2)), rel=1e-12)
    x, y = prediction.numpy(), case.test.states.numpy()
    energy = [s[..., 1] ** 2 / 4.0 + 5.0 * s[..., 0] ** 2 / 2 for s in (x, y)]
    assert scores.energy == pytest.approx(np.sqrt(np.mean((energy[0] - energy[1]) ** 2)), rel=1e-12)
    drift = STIFFER.energy(prediction)
    drift = float((drift - drift[:, :1]).square().mean().sqrt())
    assert rows[MODEL].extra["learned_energy_drift"] == pytest.approx(drift, rel=1e-6)


def test_a_perfect_model_scores_as_its_floor(tmp_path):
    rows = by_who(open_loop(make_case(tmp_path, wrong=None)))
    assert rows[MODEL].scores == rows[Who("exact field, rk4", "true", floor=True)].scores


def test_a_map_has_the_floor_of_rk4(tmp_path):
    found = floors(make_case(tmp_path, integrator=None))
    assert found["true"].who.process == "exact field, rk4"


def test_without_equations_there_are_no_floors_and_no_energies(tmp_path):
    case = make_case(tmp_path, truth=None, perturbation=None)
    findings = open_loop(case)
    assert [row.who for row in findings.rows] == [MODEL]
    assert findings.rows[0].scores.energy is None
    assert set(findings.arrays) == {"true_start"}


def test_absent_samples_do_not_count_and_a_lost_prediction_is_infinite(tmp_path):
    case = make_case(tmp_path)
    cut = torch.zeros(3, SPRING.steps + 1, dtype=torch.bool)
    cut[0, 5:], cut[1, 7] = True, True
    short = drop(case, cut)
    prediction = open_loop(case).arrays["true_start"]
    broken = prediction.clone()
    broken[cut] = torch.nan
    assert short.score(broken) == short.score(prediction)
    broken[2, 9] = torch.nan
    lost = short.score(broken)
    assert all(getattr(lost, name) == math.inf for name in FIELDS)


def test_a_trajectory_without_samples_in_the_span_does_not_count(tmp_path):
    case = make_case(tmp_path)
    cut = torch.zeros(3, SPRING.steps + 1, dtype=torch.bool)
    cut[0, 5:] = True
    prediction = open_loop(case).arrays["true_start"]
    rest = (prediction[1:, 10:], case.test.states[1:, 10:])
    energies = SPRING.energy(rest[0]), SPRING.energy(rest[1])
    expected = score(*rest, energies, SPRING.inertia)
    scores = drop(case, cut).score(prediction, first=10)
    assert scores[:5] == pytest.approx(expected[:5], rel=1e-14)


def test_moving_averages_skip_what_is_absent_and_keep_what_is_lost():
    series = torch.tensor([1.0, torch.nan, 3.0, torch.inf, 5.0, 7.0, 9.0], dtype=torch.float64)
    expected = [1.0, 1.0, 3.0, math.inf, math.inf, 6.0, 8.0]
    assert moving_average(series, 2).tolist() == expected
    assert moving_average(torch.full((3,), torch.nan), 2).isnan().all()


def plugin(**parts):
    return lambda _: Findings(**parts)


def test_no_plugin_takes_the_place_of_anything_else(tmp_path):
    case = make_case(tmp_path)
    own = evaluate(case, {}, figures=False)
    stolen = {"start": torch.zeros(1), "true_start": torch.zeros(1)}
    same = [own.rows[0]._replace(note="another")]
    plugins = {
        "rows": plugin(numbers={"a": 1}, arrays=stolen),
        "true": plugin(numbers={"a": 2}, arrays=stolen, rows=same),
        "floor": plugin(arrays=stolen),
    }
    findings = evaluate(case, plugins, figures=False)
    assert findings.numbers == own.numbers | {"rows": {"a": 1}, "true": {"a": 2}, "floor": {}}
    for key, value in own.arrays.items():
        assert torch.equal(findings.arrays[key], value)
    assert len(findings.arrays) == len(own.arrays) + 6
    assert findings.rows[: len(own.rows)] == own.rows
    assert findings.rows[-1] == Row(
        MODEL._replace(estimator="none_true"), own.rows[0].scores, "another", own.rows[0].extra
    )
    assert len({row.who for row in findings.rows}) == len(findings.rows)


def test_times_and_truth_stand_beside_the_predictions(tmp_path):
    case = make_case(tmp_path, ORBITS, None)
    arrays = evaluate(case, {}, figures=False).arrays
    assert torch.equal(arrays["times"], case.test.times)
    assert torch.equal(arrays["truth"], case.test.states)
