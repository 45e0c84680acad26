"""The Gaussian process as a model: it learns from exact states by windows, and from noise with bands."""

from __future__ import annotations

import pytest
import torch
from entry import SMALL, call
from helpers import generator
from oscillators import DOUBLE, Swing, segment

import ahnn
from ahnn.dynamics import make_dynamics
from ahnn.evaluation import load_results
from ahnn.measurements import Position
from ahnn.shooting.path_sensitivities import path
from ahnn.shooting.robust import ROBUST
from ahnn.training import LevenbergMarquardt
from ahnn.training.laplace import conclude
from ahnn.training.maximum_posterior import WideProblem
from ahnn.uncertainty import rollout_covariances


@pytest.mark.parametrize("hamiltonian", ["generic", "mechanical"])
def test_it_learns_from_windows_and_is_loaded_again(hamiltonian, tmp_path):
    asked = [f"hamiltonian={hamiltonian}", "model.network.width=16", "trainer.max_epochs=6"]
    asked += ["evaluation=scores", f"run={tmp_path / 'run'}"]
    assert call("ahnn.train", "model=gp_hamiltonian", *SMALL, *asked) == 0
    (row,) = [r for r in load_results(tmp_path / "run").rows if not r.who.floor and r.who.start == "true"]
    assert row.scores.position < 0.03
    run = ahnn.load(tmp_path / "run")
    assert run.rollout([0.5, 0.0], 3).isfinite().all()


def test_bands_after_noisy_positions_are_roughly_right():
    """The potential of an anharmonic oscillator: prior by evidence, last step of functions, covariance."""
    torch.manual_seed(0)
    options = {"dof": 1, "inertia": 1.0, "hamiltonian": "mechanical", "mu": None, "inputs": "cartesian"}
    options |= {"scaling": "none", "integrator": {"name": "rk4"}}
    network = {"width": 8, "depth": 1, "activation": "fourier"}
    model = make_dynamics("hamiltonian", **options, network=network).double()
    _, batch = segment(rows=30, measurement=Position(1), longest=0.05)
    _, other = segment(rows=10, measurement=Position(1), longest=0.05, seed=1)
    optimizer = LevenbergMarquardt(model.parameters())
    for _ in range(15):
        optimizer.step(lambda: (WideProblem(model, batch, ROBUST["none"]), None))
    found = conclude(model, batch, other, 0)
    assert found is not None
    assert found.about["chi_square"] == pytest.approx(1.0, abs=0.2)
    learned, known = found.taken(model)

    start = 0.8 * torch.randn(60, 2, generator=generator(4), **DOUBLE)
    lengths = torch.full((60, 60), 0.05, **DOUBLE)
    with torch.no_grad():
        off = path(learned.increment, start, lengths) - path(Swing().increment, start, lengths)
        band = rollout_covariances(learned, start, lengths, known.spread).diagonal(dim1=-2, dim2=-1).sqrt()
    off, band = off[:, 1:], band[:, 1:]
    within = [float((off.abs() < k * band).double().mean()) for k in (1, 3)]
    assert 0.3 < within[0] < 0.98  # one training is one draw: errors move together
    assert within[1] > 0.9
    assert float(band.median()) < 0.02
