"""A training on measurements leaves its uncertainty, and Python and a later evaluation find it."""

from __future__ import annotations

import pytest
import torch
from entry import call
from helpers import close

import ahnn
from ahnn.checkpoints import read_weights, replace_weights
from ahnn.errors import UserError
from ahnn.evaluation import load_results
from ahnn.files import write_atomically
from ahnn.loading import made, weights_path
from ahnn.uncertainty import load_uncertainty
from ahnn.uncertainty.posterior import FILE

TINY = ["data.trajectories=20", "data.windows_per_epoch=20", "data.batch_size=10", "data.val_windows=3"]
TINY += ["loss.stages=[[whole,1.0]]", "model.network.width=4", "trainer.max_epochs=1"]
TINY += ["experiment=pendulum_angles", "plugins=none", "logger=none"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A training on measurements, of two steps."""
    place = tmp_path_factory.mktemp("runs") / "angles"
    assert call("ahnn.train", *TINY, f"run={place}", "system.steps=40") == 0
    return place


def test_a_training_on_measurements_leaves_the_covariance_of_its_weights(folder):
    run = ahnn.load(folder)
    assert run.uncertainty is not None
    count = sum(p.numel() for p in run.dynamics.parameters())
    assert run.uncertainty.covariance.shape == (count, count)
    assert list(run.uncertainty.about["strengths"]) == [n for n, _ in run.dynamics.named_parameters()]
    learned = load_uncertainty(folder, made(read_weights(weights_path(folder)), folder).dynamics.state_dict())
    assert learned is not None
    assert learned.step is not None
    assert run.dynamics.spec["network"]["width"] == 12  # the step of functions is taken
    found = load_results(folder).numbers["uncertainty"]
    assert found["inflation"] == pytest.approx(run.uncertainty.inflation)
    assert len(found["coverage"]) == 3
    assert (folder / "figures" / "band.png").is_file()


@pytest.mark.slow
def test_a_training_goes_on_from_the_parameters_before_the_step_of_functions(folder, tmp_path):
    more = [*TINY, "system.steps=40", f"weights={folder}", f"run={tmp_path / 'more'}"]
    assert call("ahnn.train", *more) == 0
    assert ahnn.load(tmp_path / "more").trained.spec["network"]["width"] == 4


def test_a_run_knows_the_paths_and_the_steps_that_it_learned_from(folder):
    """Measured every 0.1 s, followed in steps of 0.025 s; smoothed measurements were known before."""
    assert ahnn.load(folder).dt == pytest.approx(0.025)
    learned = ahnn.load(folder)
    assert learned.domain is not None
    before = ahnn.load(folder, "last").domain
    assert before is not None
    assert learned.domain.unit != before.unit
    ends = learned.rollout(learned.domain.states[:5], 1)[:, 1]
    assert float(learned.novelty(ends).max()) < 2


def test_a_run_has_bands_for_any_start(folder):
    run = ahnn.load(folder)
    band = run.band([[0.5, 0.0], [1.0, 0.0]], 30)
    assert band.shape == (2, 31, 2)
    assert float(band[:, 0].abs().max()) == 0
    assert bool((band[:, 1:].isfinite() & (band[:, 1:] > 0)).all())
    assert run.band(torch.zeros(0, 2), 3).shape == (0, 4, 2)
    close(run.band([[0.5, 0.0], [1.0, 0.0]], 3, 10 * run.dt), band[:, ::10], 1e-6)


def test_a_later_evaluation_finds_the_band_too(folder):
    assert call("ahnn.evaluate", f"run={folder}", "name=again", "evaluation.figures=false") == 0
    first, again = (load_results(f) for f in (folder, folder / "evaluations" / "again"))
    assert again.numbers["uncertainty"]["coverage"] == pytest.approx(first.numbers["uncertainty"]["coverage"])


def test_other_weights_have_no_band(folder, tmp_path):
    best = ahnn.load(folder)
    assert load_results(folder).training["val_loss"] == best.about["val_loss"]
    other = tmp_path / "other.ckpt"
    write_atomically(other, (folder / "checkpoints" / "best.ckpt").read_bytes())
    trained = made(read_weights(other), folder).dynamics.state_dict()
    moved = {name: value + 1e-6 for name, value in trained.items()}
    replace_weights(other, moved, {"val_loss": 0.25})
    run = ahnn.load(folder, str(other))
    assert run.about["val_loss"] == 0.25
    assert all(torch.equal(value, moved[name]) for name, value in run.dynamics.state_dict().items())
    with pytest.raises(UserError, match=f"band: expected {FILE}"):
        run.band([0.5, 0.0], 3)


def test_a_model_that_was_not_measured_has_no_band():
    with pytest.raises(UserError, match="band: expected"):
        ahnn.load("molniya_mechanical").band(torch.zeros(6), 3)
