"""Predictions: the rollout and its band at given times, wider where the training never was."""

from __future__ import annotations

import dataclasses
import json

import pytest
import torch
from entry import SMALL, call
from helpers import close, data_module, ready_model
from oscillators import DOUBLE, Swing

import ahnn
from ahnn.checkpoints import FORMAT, Weights, write_weights
from ahnn.errors import UserError
from ahnn.prediction import Prediction, predicted, together
from ahnn.prediction.durations import duration, grid
from ahnn.prediction.propagation import Knowledge
from ahnn.systems import MassSpring
from ahnn.uncertainty import Domain, Uncertainty, find_domain, rollout_covariances, save_uncertainty

SPRING = MassSpring(name="spring", dt=0.1, steps=40, mass=2.0)
START = torch.tensor([[1.0, 0.2], [-0.5, 0.1]], **DOUBLE)
FACTOR = torch.tensor([[2e-3, 0.0], [-1e-3, 3e-3]], **DOUBLE)


def known_everywhere(**changes) -> Domain:
    """A domain of all that a swing of this size meets."""
    grid = torch.linspace(-2, 2, 21, **DOUBLE)
    domain = Domain(torch.cartesian_prod(grid, grid), 1.0)
    return domain._replace(**changes)


@torch.no_grad()
def test_on_the_grid_it_is_the_rollout_with_its_band(monkeypatch):
    times, lengths = 0.1 * torch.arange(41, **DOUBLE), torch.full((2, 40), 0.1, **DOUBLE)
    monkeypatch.setattr("ahnn.prediction.propagation.TOGETHER", 14)  # parts of seven steps
    found = predicted(Swing(), START, times, 0.1, Knowledge(FACTOR, known_everywhere()))
    assert found.covariances is not None
    assert found.novelty is not None
    x = START
    for k in range(40):
        x = Swing()(x, 0.1)
        close(found.states[:, k + 1], x, 1e-14)
    close(found.covariances, rollout_covariances(Swing(), START, lengths, FACTOR), 1e-5)
    assert float(found.novelty.max()) < 1
    assert found.deviations is not None
    close(found.deviations**2, found.covariances.diagonal(dim1=-2, dim2=-1), 1e-12)


@torch.no_grad()
@pytest.mark.parametrize("domain", [None, known_everywhere()])
def test_long_steps_are_followed_in_quarters(domain):
    """The trapezoidal rule would be off by 3 % of the variance."""
    times, lengths = 0.2 * torch.arange(31, **DOUBLE), torch.full((2, 30), 0.2, **DOUBLE)
    found, fine = (predicted(Swing(), START, times, dt, Knowledge(FACTOR, domain)) for dt in (0.2, 0.01))
    assert found.covariances is not None
    assert fine.covariances is not None
    close(found.covariances, rollout_covariances(Swing(), START, lengths, FACTOR), 1e-5)
    close(found.covariances, fine.covariances, 1e-2)
    assert found.novelty is None or found.novelty.shape == (2, 31)


@torch.no_grad()
def test_long_steps_are_the_same_in_any_parts_and_one_alone(monkeypatch):
    times = 0.2 * torch.arange(31, **DOUBLE)
    whole = predicted(Swing(), START, times, 0.2, Knowledge(FACTOR)).covariances
    alone = predicted(Swing(), START, times[:2], 0.2, Knowledge(FACTOR)).covariances
    monkeypatch.setattr("ahnn.prediction.propagation.CELLS", 1)  # parts of a step
    parted = predicted(Swing(), START, times, 0.2, Knowledge(FACTOR)).covariances
    assert whole is not None
    assert alone is not None
    assert parted is not None
    close(parted, whole, 1e-5)
    close(alone, whole[:, :2], 1e-6)


@torch.no_grad()
def test_novelty_counts_between_long_steps():
    """Known ground at the ends of a step alone: all that is novel lies within it."""
    times = 0.2 * torch.arange(2, **DOUBLE)
    ends = predicted(Swing(), START[:1], times, 0.2).states[0]
    domain = Domain(ends, 0.01 * float((ends[1] - ends[0]).norm()))
    known = predicted(Swing(), START[:1], times, 0.2, Knowledge(FACTOR)).deviations
    found = predicted(Swing(), START[:1], times, 0.2, Knowledge(FACTOR, domain))
    assert known is not None
    assert found.deviations is not None
    assert found.novelty is not None
    assert float(found.novelty.max()) == pytest.approx(0, abs=1e-6)
    assert float(found.deviations[0, 1].max()) > 100 * float(known[0, 1].max())


def test_the_covariance_of_a_start_is_carried_along_by_the_flow(monkeypatch):
    """Through derivatives of the whole path by autograd; the one of the parameters is added to it."""
    times, sd = 0.1 * torch.arange(21, **DOUBLE), torch.tensor([0.3, 0.05], **DOUBLE)
    monkeypatch.setattr("ahnn.prediction.propagation.TOGETHER", 14)  # parts of seven steps

    def end(x):
        for _ in range(20):
            x = Swing()(x, 0.1)
        return x

    moved = [torch.func.jacrev(end)(x) for x in START]
    expected = torch.stack([m @ sd.square().diag() @ m.mT for m in moved])
    of_start = predicted(Swing(), START, times, 0.1, Knowledge(start=sd.diag())).covariances
    of_both = predicted(Swing(), START, times, 0.1, Knowledge(FACTOR, start=sd.diag())).covariances
    of_model = predicted(Swing(), START, times, 0.1, Knowledge(FACTOR)).covariances
    assert of_start is not None
    assert of_both is not None
    assert of_model is not None
    close(of_start[:, 0], sd.square().diag().expand(2, 2, 2), 1e-6)
    close(of_start[:, -1], expected, 1e-4)
    close(of_both, of_start + of_model, 1e-5)


@torch.no_grad()
def test_times_between_the_steps_are_met_exactly():
    """By an integrator of order 4 at two step sizes: both are near the same solution."""
    times = torch.tensor([0.0, 0.13, 0.5, 1.97, 2.0], **DOUBLE)
    fine = predicted(Swing(), START, times, 1e-3)
    coarse = predicted(Swing(), START, times, 0.05)
    assert fine.states.shape == (2, 5, 2)
    close(coarse.states, fine.states, 1e-5)
    later = predicted(Swing(), START, times + 7.0, 0.05)  # the laws do not depend on time
    close(later.states, coarse.states, 1e-12)


@torch.no_grad()
def test_the_band_grows_where_the_path_leaves_the_training_data():
    times = 0.1 * torch.arange(21, **DOUBLE)
    inside = Knowledge(FACTOR, known_everywhere())
    nowhere = Knowledge(FACTOR, known_everywhere(unit=1e-3))  # between the points of the grid all is novel
    near = predicted(Swing(), START, times, 0.1, inside).deviations
    far = predicted(Swing(), START, times, 0.1, nowhere)
    assert near is not None
    assert far.deviations is not None
    assert far.novelty is not None
    assert float(far.novelty[:, 1:].min()) > 1
    assert float((far.deviations[:, 2:] / near[:, 2:]).min()) > 50


def test_several_trainings_give_their_mean_and_the_law_of_total_covariance():
    draw = torch.randn(3, 1, 2, 2, **DOUBLE)
    own = torch.eye(2, **DOUBLE).expand(1, 2, 2, 2)
    times, far = torch.arange(2.0), torch.tensor([[1.0, 2.0]])
    each = [Prediction(times, x, k * own, k * far) for k, x in enumerate(draw, start=1)]
    found = together(each)
    assert found.covariances is not None
    assert found.novelty is not None
    close(found.states, draw.mean(0), 1e-14)
    for b, t in ((0, 0), (0, 1)):
        close(found.covariances[b, t], torch.cov(draw[:, b, t].mT) + 2 * torch.eye(2, **DOUBLE), 1e-12)
    close(found.novelty, 3 * far, 1e-12)
    assert together(each[:1]) is each[0]
    without = together([each[0], each[1]._replace(covariances=None, novelty=None)])
    assert without.novelty is None
    assert without.covariances is not None


@pytest.mark.parametrize(
    ("value", "base", "expected"),
    [
        ("1d", "s", 86400),
        ("90min", "s", 5400),
        ("2 h", "min", 120),
        (7, "s", 7),
        ("7", "1", 7),
        ("1e2ms", "s", 0.1),
    ],
)
def test_durations(value, base, expected):
    assert duration(value, "duration", base) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("value", "base"),
    [("1km", "s"), ("-1", "s"), (0, "s"), ("nan", "s"), ("1d", "1"), ("soon", "s"), ("1.2.3s", "s")],
)
def test_what_is_no_duration_is_refused_by_name(value, base):
    with pytest.raises(UserError, match=r"step: expected a positive duration.*received"):
        duration(value, "step", base)


def test_the_last_step_ends_on_the_duration():
    assert grid(1.0, 0.4).tolist() == [0.0, 0.4, 0.8, 1.0]
    assert len(grid(86400.0, 60.0)) == 1441
    assert len(grid(0.3, 0.1)) == 4  # and not five


def small(folder, cache, seed=0, band=False, domain=True):
    """A run folder of a tiny model, untrained, and its run."""
    data = data_module(SPRING, cache, steps=40)
    model = ready_model("mechanical", data, seed=seed)
    dynamics = model.dynamics.frozen()
    about = {**model.about, "format": FORMAT, "dynamics": model.dynamics.spec, "val_loss": 1.0}
    if domain:
        about["domain"] = find_domain(dynamics, data.examples()).about()
    folder.mkdir()
    write_weights(folder / "weights.safetensors", Weights(dynamics.state_dict(), about))
    if band:
        count = sum(p.numel() for p in dynamics.parameters())
        factor = 1e-3 * torch.eye(count, **DOUBLE)
        uncertainty = Uncertainty(factor, torch.zeros(count, **DOUBLE), 1.0, {})
        save_uncertainty(folder, uncertainty, ahnn.load(folder).dynamics.state_dict())
    return ahnn.load(folder)


def test_a_run_predicts_what_its_rollout_and_band_say(tmp_path, cache):
    run = small(tmp_path / "run", cache, band=True)
    start = run.domain.states[7]
    found = run.predict(start, run.dt * torch.arange(9.0, dtype=torch.float64))
    close(found.states, run.rollout(start, steps=8), 1e-14)
    assert found.deviations is not None
    assert found.novelty is not None
    close(found.novelty, run.novelty(found.states), 1e-12)
    if float(found.novelty.max()) <= 1:
        close(found.deviations, run.band(start, steps=8), 1e-4)


@pytest.mark.parametrize(
    ("start", "times", "message"),
    [
        ([1.0, torch.nan], [0, 1], r"start: expected finite numbers.*in start 1"),
        ([1.0], [0, 1], r"start: expected states \[q, p\]"),
        ([1.0, 0.0], [0, 0], r"times: expected two or more increasing times"),
        ([1.0, 0.0], [0], r"times: expected two or more"),
        ([1.0, 0.0], 3.0, r"times: expected two or more"),
        ([1.0, 0.0], [0, torch.inf], r"times: expected two or more"),
    ],
)
def test_what_cannot_be_predicted_is_refused_by_name(start, times, message, tmp_path, cache):
    run = small(tmp_path / "run", cache)
    with pytest.raises(UserError, match=message):
        run.predict(start, times)


def test_a_training_keeps_where_its_data_were(tmp_path):
    folder = tmp_path / "run"
    assert call("ahnn.train", *SMALL, f"run={folder}", "trainer.max_epochs=1") == 0
    for ckpt in ("best", "last"):
        run = ahnn.load(folder, ckpt)
        assert run.domain is not None
        assert run.domain.states.shape == (488, 2)  # half of 16 x 61
        assert json.loads(json.dumps(run.about["domain"])) == run.about["domain"]
    states = dataclasses.replace(SPRING, mass=1.0).initial_states(20, torch.Generator().manual_seed(0))
    assert float(run.novelty(3.0 * states + 3.0).min()) > 1
