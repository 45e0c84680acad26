"""The gallery: each script draws its picture, and its number agrees with a truth of another origin."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
import torch
from entry import untouched

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "gallery.md").read_text()
SHOWN = re.findall(r"\(gallery/(\w+)\.png\)", PAGE)


@pytest.fixture
def gallery(tmp_path, monkeypatch):
    """Run a script of the gallery and return its names."""
    monkeypatch.chdir(tmp_path)
    mpl.use("Agg")

    def run(name):
        with untouched():
            found = runpy.run_path(str(ROOT / "examples" / f"{name}.py"))
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
        return found

    yield run
    mpl.pyplot.close("all")


def test_the_page_shows_ten_scripts_with_small_pictures():
    assert len({*SHOWN}) == 10
    size = sum((ROOT / "docs" / "gallery" / f"{name}.png").stat().st_size for name in SHOWN)
    assert size < 1e6
    for name in SHOWN:
        lines = (ROOT / "examples" / f"{name}.py").read_text().splitlines()
        assert f"examples/{name}.py" in PAGE
        assert lines[0].endswith(f'`python examples/{name}.py`."""')


@pytest.mark.slow
def test_energy_of_rk4_drifts_in_proportion_to_time_and_of_symplectic_methods_does_not(gallery):
    worst = gallery("energy_drift")["worst"]
    assert 80 < float(worst["rk4"][-1] / worst["rk4"][0]) < 120
    for name in ("leapfrog", "yoshida4"):
        assert float(worst[name].max() / worst[name].min()) < 1.2


@pytest.mark.slow
def test_the_learned_separatrix_has_the_energy_of_the_upright_pendulum(gallery):
    found = gallery("phase_portrait")
    with torch.no_grad():
        low, high = found["model"].energy(torch.tensor([[0.0, 0.0], [torch.pi, 0.0]]).double())
    assert float(high - low) == pytest.approx(2 * 9.81, rel=0.005)


@pytest.mark.slow
def test_the_forecast_deviation_is_the_scatter_of_orbits_by_scipy(gallery):
    found = gallery("molniya_forecast")
    ratios = found["rms"][1:] / found["spread"][1:]
    assert 0.6 < float(ratios.median()) < 1.5


@pytest.mark.slow
def test_the_forecast_from_a_csv_is_within_its_band_of_scipy(gallery):
    found = gallery("noisy_csv")
    assert np.abs(found["angle"] - found["truth"]).max() < 0.1
    assert found["inside"] > 0.8


@pytest.mark.slow
def test_the_friction_is_within_its_deviation_of_the_simulated_one(gallery):
    found = gallery("damped_pendulum")
    assert abs(found["value"] - 0.3) < min(4 * found["sd"], 0.015)


@pytest.mark.slow
def test_the_hamiltonian_predicts_unseen_swings_better_than_the_neural_ode(gallery):
    scores = gallery("compare_models")["scores"]
    assert float(scores["Hamiltonian"][-1]) < float(scores["neural ODE"][-1]) / 2


@pytest.mark.slow
def test_the_gate_rejects_the_wrong_fixes_alone(gallery):
    found = gallery("stream_with_outliers")
    assert found["rejected"].equal(found["wrong"])
    rms = {name: float(e.square().mean().sqrt()) for name, e in found["errors"].items()}
    assert rms["smoother"] < 0.7 * rms["filter"] < 0.7


@pytest.mark.slow
def test_least_squares_fits_within_the_noise_and_finds_the_true_orbit(gallery):
    found = gallery("orbit_determination")
    count, cost = found["count"], float(found["fit"].cost)
    assert abs(cost - count) < 5 * (2 * count) ** 0.5
    errors = found["errors"]["least squares, all sightings"][1:]
    assert bool((errors < 3 * found["spread"]).all())


@pytest.mark.slow
def test_the_planned_deviation_is_that_of_the_information_by_differences(gallery):
    found = gallery("plan_measurements")
    start, times, prior, run = (found[name] for name in ("start", "times", "prior", "run"))
    half = 1e-3 * prior.diag().sqrt().diag()
    paths = run.predict(torch.cat((start + half, start - half)), times).states[..., :3]
    slopes = ((paths[:6] - paths[6:]) / (2 * half.diag()[:, None, None])).permute(1, 2, 0)  # (T, 3, 6)
    chosen = slopes[found["plan"].chosen] / found["SD"]
    covariance = (prior.inverse() + torch.einsum("kij,kil->jl", chosen, chosen)).inverse()
    expected = (slopes[-1] @ covariance @ slopes[-1].T).trace().sqrt()
    assert float(found["planned"][-1]) == pytest.approx(float(expected), rel=0.01)


@pytest.mark.slow
def test_learned_orbits_keep_the_energy_of_henon_and_heiles(gallery):
    path = gallery("henon_heiles_section")["paths"]["learned"]
    x, y, px, py = path.unbind(-1)
    energy = (px**2 + py**2 + x**2 + y**2) / 2 + x**2 * y - y**3 / 3
    assert float((energy - 0.125).abs().max()) < 0.03 * 0.125
