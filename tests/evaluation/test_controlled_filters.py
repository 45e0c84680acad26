"""Filters of a controlled motion in an evaluation: all of them know the controls of each trajectory."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from evaluating import case_of, run
from motions.pushed_spring import PushedSpring

from ahnn.systems import exact_flow

SYSTEM = PushedSpring(name="pushed", dt=0.05, steps=80)
FILTER = ["cadence=4", "measurement_sd=1e-3", "process_noise=[1e-7,1e-7]", "start_sd=[0.03,0.03]"]
OPTIONS = [*FILTER, "smoother=true", "least_squares=true"]


@pytest.fixture
def case(tmp_path):
    off = 0.03 * torch.randn(30, 2, generator=torch.Generator().manual_seed(0)).double()
    return case_of(SYSTEM, exact_flow(SYSTEM), off, tmp_path)


SLOWER = [pytest.param(name, marks=pytest.mark.slow) for name in ("ekf", "enkf")]


@pytest.mark.parametrize("name", ["ukf", *SLOWER])
def test_filters_smoothers_and_least_squares_are_consistent_under_pushes(case, name):
    findings = run(case, *OPTIONS, group=name)
    for found in findings.numbers["filters"].values():
        low, high = found["model"]["perturbed"]["nees"]["band_95"]
        assert low < found["model"]["perturbed"]["nees"]["mean"] < high
    blind = dataclasses.replace(case, test=case.test._replace(controls=torch.zeros_like(case.test.controls)))
    assert (
        run(blind, *FILTER, group=name).numbers["filters"][name]["model"]["perturbed"]["nees"]["mean"] > 1e3
    )


def test_process_noise_is_fitted_under_the_controls_too(case):
    findings = run(case, "cadence=4", "measurement_sd=1e-3", "process_noise=force_error")
    assert findings.numbers["process_noise"]["size"] < 1e-6  # the flow is exact
