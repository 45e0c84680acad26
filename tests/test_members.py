"""Members trained at once are the trainings of their seeds, one after the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from entry import SMALL, Interrupted, call, untouched
from helpers import SPRING, close, data_module, ready_model

import ahnn
from ahnn import ensembles
from ahnn.checkpoints import read_weights
from ahnn.cli.compose import compose_job
from ahnn.cli.prepare import prepare
from ahnn.cli.training import train
from ahnn.estimation import initial_belief
from ahnn.fitting import check_given
from ahnn.measurements import Position
from ahnn.models import EnsembleModel, Optimisation
from ahnn.prediction import together
from ahnn.rollouts import rollout
from ahnn.uncertainty import Uncertainty
from ahnn_plugins.ukf import unscented_filter

SECOND = ["optimizer=levenberg_marquardt", "data.precision=64"]
CASES = {
    "gradient steps in C": (["model=ahnn", "recipe=first_order", "callbacks.mean.fraction=0.5"], 1e-4),
    "gradient steps by vmap": (["model=node", "recipe=first_order"], 1e-4),
    "derivatives, then predictions": (["model=hnn", "recipe=first_order", "loss.derivative=0.5"], 1e-4),
    "maps": (["model=mlp", "recipe=first_order"], 1e-4),
    "second-order steps at once": (["model=hnn", *SECOND], 1e-3),
    "second-order steps one by one": (["model=hnn", *SECOND, "model.network.width=24"], 1e-9),
    "measurements": (
        ["recipe=measurements", "data.noise=0.01", "data.every=3", "loss.stages=[[4,1.0]]"],
        1e-10,
    ),
}


@pytest.fixture(autouse=True)
def no_evaluation(request, monkeypatch):
    if "evaluated" not in request.fixturenames:
        monkeypatch.setattr("ahnn.jobs.closing.judge", lambda *_, **__: 0.0)


def trained(folder, words, **changes):
    cfg = compose_job([*SMALL, *words], folder)
    for key, value in changes.items():
        cfg[key] = value
    with untouched():
        train(cfg)
    return folder


def best(folder, seed):
    return read_weights(folder / f"seed_{seed}" / "checkpoints" / "best.ckpt")


@pytest.mark.parametrize("case", CASES)
@pytest.mark.sampled(4)
def test_each_member_is_the_training_of_its_seed(case, tmp_path):
    words, accuracy = CASES[case]
    at_once = trained(tmp_path / "at_once", [*words, "members=2", "seed=7"])
    in_turn = trained(tmp_path / "in_turn", [*words, "seeds=[7,8]"])
    for seed in (7, 8):
        found, wanted = best(at_once, seed), best(in_turn, seed)
        assert found.about["val_loss"] == pytest.approx(wanted.about["val_loss"], rel=10 * accuracy)
        assert found.about["settings"] == wanted.about["settings"]
        assert found.state.keys() == wanted.state.keys()
        for name, value in wanted.state.items():
            close(found.state[name], value, accuracy)
    one, other = (torch.cat([v.flatten() for v in best(at_once, seed).state.values()]) for seed in (7, 8))
    assert float((one - other).abs().max()) > 0.1


@pytest.mark.parametrize("kind", [["recipe=first_order"], SECOND], ids=["gradient", "second order"])
def test_a_cut_ensemble_ends_with_the_same_weights(kind, tmp_path):
    words = ["model=hnn", *kind, "members=2", "callbacks.last.every=4"]
    whole, cut = trained(tmp_path / "whole", words), tmp_path / "cut"
    cfg = compose_job([*SMALL, *words], cut)
    callbacks = {**cfg.callbacks, "cut": {"_target_": "entry.CutAfter", "steps": 15}}
    with pytest.raises(Interrupted):
        trained(cut, words, callbacks=callbacks)
    trained(cut, words, ckpt="last")
    for seed in (7, 8):
        found, wanted = best(cut, seed).state, best(whole, seed).state
        assert all(torch.equal(found[name], value) for name, value in wanted.items())


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ensemble") / "run"
    words = ["model=ahnn", "recipe=first_order", "members=3", "evaluation=scores"]
    assert call("ahnn.train", *SMALL, *words, f"run={folder}") == 0
    return folder


def test_an_ensemble_is_the_mixture_of_its_members(evaluated):
    ensemble = ahnn.load_ensemble(evaluated)
    runs = [ahnn.load(evaluated / f"seed_{seed}") for seed in (7, 8, 9)]
    start, steps = torch.tensor([[0.5, 0.1], [-0.3, 0.7]], dtype=torch.float64), 30
    paths = np.stack([rollout(run.dynamics, start, run.dt, steps + 1).numpy() for run in runs])
    close(ensemble.rollout(start, steps), torch.from_numpy(paths.mean(0)), 1e-12)
    close(ensemble.band(start, steps), torch.from_numpy(paths.std(0, ddof=1)), 1e-9)
    times = runs[0].dt * torch.arange(steps + 1)
    found, wanted = ensemble.predict(start, times), together([run.predict(start, times) for run in runs])
    close(found.states, wanted.states, 1e-12)
    assert found.covariances is not None
    assert wanted.covariances is not None
    close(found.covariances, wanted.covariances, 1e-12)
    after = np.stack([run.flow(start, 0.05).numpy() for run in runs])
    close(ensemble.flow(start, 0.05), torch.from_numpy(after.mean(0)), 1e-12)
    own = np.mean([np.cov(after[:, k].T) for k in range(2)], axis=0)
    close(ensemble.process_noise(0.05, start), torch.from_numpy(own), 1e-9)


def test_a_prediction_takes_the_folder_of_an_ensemble(evaluated, tmp_path):
    table = tmp_path / "table.csv"
    asked = ["start=[0.5,0.1]", "duration=0.3", f"run={evaluated}", f"output={table}"]
    assert call("ahnn.predict", *asked) == 0
    last = [float(word) for word in table.read_text().splitlines()[-1].split(",")]
    start = torch.tensor([[0.5, 0.1]], dtype=torch.float64)
    wanted = ahnn.load_ensemble(evaluated).rollout(start, 30)[0, -1]
    assert last[2:4] == pytest.approx(wanted.tolist(), rel=1e-6)


def test_one_run_is_not_an_ensemble_and_an_ensemble_not_one_run(evaluated):
    with pytest.raises(ahnn.UserError, match=r"received that of 3 members.*load_ensemble"):
        ahnn.load(evaluated)
    with pytest.raises(ahnn.UserError, match="expected a folder of a training with members"):
        ahnn.load_ensemble(evaluated / "seed_7")


def test_a_member_whose_training_failed_is_named(evaluated, monkeypatch, caplog):
    """More than twice the smallest chi-square; members without a covariance are not judged."""
    ahnn.load_ensemble(evaluated)
    assert not caplog.messages
    chi_squares = {"seed_7": 1.1, "seed_8": 0.9, "seed_9": 1.9}

    def known(folder, ckpt):
        run, one = ahnn.load(folder, ckpt), torch.eye(2, dtype=torch.float64)
        about = {"chi_square": chi_squares[folder.name]}
        return replace(run, uncertainty=Uncertainty(one, one[0], 1.0, about))

    monkeypatch.setattr(ensembles, "load", known)
    ahnn.load_ensemble(evaluated)
    (message,) = caplog.messages
    assert "seed_9 is more than twice" in message
    assert "seed_7" not in message


REFUSED = {
    "members=1": "members: expected int from 2 to 64",
    "members=2 seeds=[1,2]": "seeds: expected null, since members use",
    "members=2 seed=4294967295": "seed: expected at most 4294967294, since each member has its own seed",
    "members=2 weights=molniya_mechanical": "weights: expected null",
    "members=2 trainer.gradient_clip_val=1.0": "trainer.gradient_clip_val: expected none with members",
}


@pytest.mark.parametrize("mistake", REFUSED)
def test_what_would_couple_members_is_refused(mistake, tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = [*SMALL, "recipe=first_order", f"run={tmp_path / 'run'}", *mistake.split()]
    assert call("ahnn.train", *words) == 2
    err = capfd.readouterr().err
    assert REFUSED[mistake] in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_optimiser_that_couples_weights_is_refused(tmp_path):
    data = data_module(SPRING, str(tmp_path))
    models = [ready_model("hnn", data, seed) for seed in (1, 2)]
    for model in models:
        model.train_by(Optimisation(torch.optim.LBFGS, None), {})
    with pytest.raises(ahnn.UserError, match=r"treats each weight separately.*received LBFGS"):
        EnsembleModel(models)


def test_members_are_refused_where_one_model_is_trained(tmp_path):
    with pytest.raises(ahnn.UserError, match="one training run; received members=2"):
        check_given(["members=2"], tmp_path / "run")
    with pytest.raises(ahnn.UserError, match="one model is trained here; received 2"):
        prepare(compose_job(["members=2"], tmp_path / "run"))


def test_a_filter_without_measurements_has_the_spread_of_the_members(evaluated):
    ensemble = ahnn.load_ensemble(evaluated)
    start = torch.tensor([[0.5, 0.1]], dtype=torch.float64)
    noise, missing = ensemble.process_noise(states=start), torch.full((1, 1, 1), torch.nan)
    belief = initial_belief(start, 1e-16 * torch.eye(2))
    one = torch.eye(1, dtype=torch.float64)
    result = unscented_filter(ensemble.flow, belief, missing, Position(1), noise, one, ensemble.dt)
    after = torch.stack([run.flow(start) for run in ensemble.runs])
    close(result.means[0], after.mean(0), 1e-6)
    close((result.chols @ result.chols.mT)[0, 0], torch.from_numpy(np.cov(after[:, 0].T)), 1e-6)
