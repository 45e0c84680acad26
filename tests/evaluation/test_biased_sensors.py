"""Biases of sensors in an evaluation: simulated, and estimated with the state by any estimator."""

from __future__ import annotations

import pytest
from evaluating import case_of, run

from ahnn.evaluation.case import perturbations
from ahnn.evaluation.open_loop import Integrated
from ahnn.integrators import INTEGRATORS
from ahnn.systems import MassSpring

SPRING = MassSpring(name="spring", dt=0.02, steps=100)
OPTIONS = ["cadence=5", "measurement_sd=3e-4", "bias_sd=0.05", "process_noise=[1e-8,1e-8]"]


@pytest.fixture
def spring(tmp_path):
    flow = Integrated(SPRING, INTEGRATORS["rk4"])
    return case_of(SPRING, flow, perturbations(SPRING, 20, seed=0), tmp_path)


SLOWER = [pytest.param(name, marks=pytest.mark.slow) for name in ("ekf", "enkf")]


@pytest.mark.parametrize("name", ["ukf", *SLOWER])
def test_filters_stay_consistent_beside_biases_many_times_the_noise(spring, name):
    findings = run(spring, *OPTIONS, group=name)
    found = findings.numbers["filters"][name]["floor"]["perturbed"]
    assert findings.numbers["bias"] == [[0.05], [float("inf")]]
    assert findings.arrays["perturbed_start"].shape == spring.test.states.shape
    assert found["status"]["OK"] == 20
    for row in findings.rows:  # the state is known far better than the bias, 0.05
        assert row.scores.position < 3e-3
    for key in ("nees", "nis"):
        low, high = found[key]["band_95"]
        assert low < found[key]["mean"] < high


@pytest.mark.slow
def test_smoothers_and_least_squares_estimate_them_too(spring):
    findings = run(spring, *OPTIONS, "smoother=true", "least_squares=true", "cadence=10")
    judged = {row.who.estimator: row.scores.position for row in findings.rows if row.who.span == "whole"}
    assert len(judged) == 3
    assert max(judged.values()) < 3e-3
