"""NEES, NIS and RMSE of a filter that knows the dynamics, and the measures themselves."""

from __future__ import annotations

import pytest
import torch

from ahnn.data.generate import generate
from ahnn.estimation.consistency import band, coverage, nees, share_within
from ahnn.evaluation.case import perturbations
from ahnn.evaluation.open_loop import exact_flow
from ahnn.integrators import INTEGRATORS
from ahnn.metrics import errors, rmse_pooled
from ahnn.systems import Molniya
from ahnn_plugins.ukf import SQUARE_ROOT, Position, UnscentedParameters
from ahnn_plugins.ukf.process_noise import crossing
from ahnn_plugins.ukf.scenario import Filter, Problem, assimilate, simulated, validation_problem
from ahnn_plugins.ukf.setting import Setting


@pytest.mark.parametrize(("start", "whole"), [("true", (0.0, 1.0)), ("perturbed", (13.0, 17.0))])
def test_exact_dynamics_on_125_orbits(start: str, whole: tuple[float, float]) -> None:
    system = Molniya(name="orbits", dt=60.0, steps=1440)
    truth = generate(system, 125, seed=1).states
    hourly = tuple(range(60, 1441, 60))
    setting = Setting(Position(), torch.ones(3).double(), system.deviations(), hourly, SQUARE_ROOT, None)
    begin = truth[:, 0] + (perturbations(system, 125, seed=0) if start == "perturbed" else 0.0)
    problem = Problem(truth, begin, simulated(setting, truth, 60.0, seed=0), 60.0)
    flow = exact_flow(system, INTEGRATORS[system.integrator])
    nothing = torch.zeros(6, 6, dtype=torch.float64)
    exact = Filter("exact", flow, nothing, setting.measurement_noise, UnscentedParameters())
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


def test_nees_is_the_quadratic_form() -> None:
    generator = torch.Generator().manual_seed(0)
    chol = torch.randn(2, 3, 4, 4, generator=generator, dtype=torch.float64).tril() + 3 * torch.eye(4)
    error = torch.randn(2, 3, 4, generator=generator, dtype=torch.float64)
    expected = torch.einsum("bti,btij,btj->bt", error, torch.linalg.inv(chol @ chol.mT), error)
    torch.testing.assert_close(nees(error, chol), expected, rtol=1e-12, atol=0)


def test_band_holds_95_percent_of_gaussian_means() -> None:
    generator = torch.Generator().manual_seed(0)
    means = torch.randn(20_000, 10, 6, generator=generator).square().sum(-1).mean(-1)
    assert share_within(means, band(6, 10)) == pytest.approx(0.95, abs=0.006)


def test_coverage_of_gaussian_errors_leaves_out_what_is_missing() -> None:
    error = 2 * torch.randn(1, 100_000, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    error[:, :50_000, 0] = torch.nan
    shares = coverage(error, torch.full_like(error, 2.0))
    assert [shares[k] for k in (1, 2, 3)] == pytest.approx([0.6827, 0.9545, 0.9973], abs=0.004)


def test_crossing_of_a_power_law_is_exact() -> None:
    scales = (0.1, 1.0, 10.0, 100.0)
    assert crossing(scales, [300 / s for s in scales], 6.0) == pytest.approx(50.0)
    assert crossing(scales, [1.0, 0.1, 0.01, 0.001], 6.0) == 0.1
    assert crossing(scales, [float("inf"), float("nan"), 5.0, 1.0], 6.0) == 10.0
    assert crossing(scales, [float("inf")] * 4, 6.0) == 100.0


def test_validation_arcs_spread_over_their_trajectories() -> None:
    system = Molniya(name="orbits", dt=60.0, steps=40)
    data = generate(system, 3, seed=0)
    setting = Setting(
        Position(), torch.ones(3).double(), system.deviations(), tuple(range(5, 61, 5)), SQUARE_ROOT, None
    )
    arcs = validation_problem(setting, data, 3, steps=10, seed=0)
    for b, begin in enumerate((0, 15, 30)):
        assert torch.equal(arcs.truth[b], data.states[b, begin : begin + 11])
    measured = arcs.measurements.isfinite().all(-1)
    assert measured[:, [4, 9]].all()
    assert int(measured.sum()) == 6
