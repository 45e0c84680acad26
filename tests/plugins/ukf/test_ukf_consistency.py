"""NEES, NIS and RMSE of a filter that knows the dynamics, and the measures themselves."""

from __future__ import annotations

import pytest
import torch

from ahnn.data.generate import generate
from ahnn.estimation import Problem, Setting, simulated
from ahnn.estimation.consistency import band, nees
from ahnn.estimation.process_noise import crossing
from ahnn.estimation.trial import Filter, assimilate
from ahnn.evaluation.case import perturbations
from ahnn.evaluation.open_loop import Integrated
from ahnn.integrators import INTEGRATORS
from ahnn.measurements import Position
from ahnn.metrics import errors, rmse_pooled
from ahnn.systems import Molniya
from ahnn_plugins.ukf import UnscentedKalmanFilter


@pytest.mark.slow
@pytest.mark.parametrize(("start", "whole"), [("true", (0.0, 1.0)), ("perturbed", (13.0, 17.0))])
def test_exact_dynamics_on_125_orbits(start: str, whole: tuple[float, float]) -> None:
    system = Molniya(name="orbits", dt=60.0, steps=1440)
    truth = generate(system, 125, seed=1).states
    hourly = tuple(range(60, 1441, 60))
    setting = Setting(Position(), torch.ones(3).double(), system.deviations(), hourly)
    begin = truth[:, 0] + (perturbations(system, 125, seed=0) if start == "perturbed" else 0.0)
    problem = Problem(truth, begin, simulated(setting, truth, 60.0, seed=0), 60.0)
    flow = Integrated(system, INTEGRATORS[system.integrator])
    nothing = torch.zeros(6, 6, dtype=torch.float64)
    exact = Filter("exact", flow, nothing, setting.measurement_noise, UnscentedKalmanFilter())
    result = assimilate(exact, setting, problem)
    error = errors(result.means, truth[:, 1:])
    assert whole[0] <= float(rmse_pooled(error[..., :3])) <= whole[1]
    assert float(rmse_pooled(error[:, 59:, :3])) <= 1.0
    assert int(result.repairs.sum()) == 0
    if start == "perturbed":
        low, high = band(6, 125)
        assert low < float(nees(error, result.chols)[:, 59:].mean()) < high
        low, high = band(3, 125)
        assert low < float(result.nis.nanmean()) < high


def test_crossing_of_a_power_law_is_exact() -> None:
    scales = (0.1, 1.0, 10.0, 100.0)
    assert crossing(scales, [300 / s for s in scales], 6.0) == pytest.approx(50.0)
    assert crossing(scales, [1.0, 0.1, 0.01, 0.001], 6.0) == 0.1
    assert crossing(scales, [float("inf"), float("nan"), 5.0, 1.0], 6.0) == 10.0
    assert crossing(scales, [float("inf")] * 4, 6.0) == 100.0
