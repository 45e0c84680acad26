"""The package in Python: loading without a trainer, training on one's own tensors, names and types."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
import torch
from entry import SMALL, call, untouched
from helpers import close

import ahnn
from ahnn.errors import UserError
from ahnn.evaluation import Who

TINY = [
    "model=hnn",
    "trainer.max_epochs=2",
    "trainer.accelerator=cpu",
    "logger=none",
    "model.network.width=8",
]


def test_every_public_name_is_there_and_documented():
    for name in ahnn.__all__:
        thing = getattr(ahnn, name)
        assert name == "__version__" or thing.__doc__
    assert dir(ahnn) == sorted(ahnn.__all__)
    with pytest.raises(AttributeError, match="no attribute 'lod'"):
        _ = ahnn.lod


def oscillators(count=40, samples=120, irregular=False, omega=2.0):
    """Exact trajectories of H = (p^2 + omega^2 q^2) / 2."""
    draw = torch.Generator().manual_seed(0)
    a, phase = torch.rand(2, count, 1, generator=draw, dtype=torch.float64)
    steps = 0.05 * (0.5 + torch.rand(count, samples, generator=draw)).double()
    t = steps.cumsum(1) if irregular else 0.05 * torch.arange(samples, dtype=torch.float64).expand(count, -1)
    angle = omega * t + 6 * phase
    q, p = (0.5 + a) * angle.cos(), -omega * (0.5 + a) * angle.sin()
    return ahnn.Trajectories(torch.stack((q, p), dim=-1), t)


SPACE = ahnn.Space("oscillator", ("q", "p"), ahnn.Units("s", "m", "m/s", "J"))


def fitted(data, folder, *overrides):
    with untouched(), pytest.MonkeyPatch.context() as patch:  # whose process this is, has his own collector
        patch.setattr("ahnn.cli.importing._leave_alone", pytest.fail)
        return ahnn.fit(data, SPACE, [*TINY, *overrides], folder=folder)


def test_tensors_of_ones_own_train_and_are_evaluated(tmp_path, capsys):
    run = fitted(oscillators(), tmp_path / "run", "trainer.max_epochs=10", "data.batch_size=500")
    results = run.results
    assert [row.who for row in results.rows] == [Who("model", "true")]  # nothing is known of the equations
    assert results.rows[0].scores.energy is None
    assert results.space == SPACE
    assert "oscillator" in capsys.readouterr().out
    test = run.rollout(oscillators().states[-1, 0], steps=119)
    error = (test[0] - oscillators().states[-1]).norm(dim=-1)
    assert float(error.mean()) < 0.1


def test_missing_samples_and_times_of_their_own_train(tmp_path):
    data = oscillators(irregular=True)
    states = data.states.clone()
    states[::3, 50] = torch.nan
    steps = ["loss.derivative=0", "window=2", "optimizer=levenberg_marquardt"]
    run = fitted(data._replace(states=states), tmp_path / "run", *steps, "trainer.max_epochs=8")
    (row,) = run.results.rows
    truth, x, errors = states[-2:], states[-2:, 0], []
    for k in range(119):
        x = run.dynamics(x, data.times[-2:, k + 1] - data.times[-2:, k])
        errors.append((x - truth[:, k + 1])[:, 0])
    rms = torch.stack([torch.zeros(2), *errors]).square().nanmean(0).sqrt()
    assert row.scores.position == pytest.approx(float(rms.mean()), rel=1e-9)


def test_derivatives_of_samples_at_irregular_times_are_refused(tmp_path):
    with pytest.raises(UserError, match=r"equal steps .*received unequal steps.*loss\.derivative=0"):
        fitted(oscillators(irregular=True), tmp_path / "run", "loss=derivative")


WRONG = {
    "states": (
        lambda d: d._replace(states=d.states[0]),
        r"states: expected shape \(trajectories, samples, 2\)",
    ),
    "components": (lambda d: d._replace(states=d.states.repeat(1, 1, 2)), r"received \(40, 120, 4\)"),
    "positions": (lambda d: d._replace(states=d.states[..., :1]), "data.noise: expected the standard dev"),
    "times": (lambda d: d._replace(times=d.times[:, :5]), r"times: expected shape \(40, 120\), or \(120,\)"),
    "order": (
        lambda d: d._replace(times=-d.times),
        r"times: expected increasing times; received \[-?0.0, -0.05\]",
    ),
    "infinite": (lambda d: d._replace(states=d.states / 0), r"NaN where a sample is absent; received"),
    "nothing": (
        lambda d: d._replace(states=d.states * torch.nan),
        r"trajectory 0, row 1: expected a trajectory with a complete sample",
    ),
    "words": (lambda d: d._replace(states="a"), r"states: expected numbers"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_trajectories_that_are_none_are_refused_by_name(tmp_path, wrong):
    change, message = WRONG[wrong]
    with pytest.raises(UserError, match=message):
        fitted(change(oscillators()), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_overrides_that_name_other_data_are_refused(tmp_path):
    with pytest.raises(UserError, match=r"expected the data as `trajectories`.*received system=molniya"):
        ahnn.fit(oscillators(), SPACE, ["system=molniya"], folder=tmp_path / "run")


def test_a_run_is_the_model_that_was_trained(tmp_path):
    assert (
        call("ahnn.train", *SMALL, "evaluation.figures=false", "data.precision=64", f"run={tmp_path / 'run'}")
        == 0
    )
    run = ahnn.load(tmp_path / "run")
    again = ahnn.load(str(tmp_path / "run"), ckpt="last")
    assert {p.dtype for p in run.dynamics.parameters()} == {torch.float64}
    assert not any(p.requires_grad for p in run.dynamics.parameters())
    with pytest.raises(UserError, match=r"dtype: expected torch\.float32 or torch\.float64"):
        run.to(dtype=torch.float16)
    x = torch.tensor([[0.5, 0.0], [0.1, -0.3]], dtype=torch.float64)
    path = run.rollout(x, steps=3)
    close(path[:, 3], run.flow(run.flow(run.flow(x))), 1e-15)
    close(run.flow(x, 3 * run.dt), path[:, 3], 1e-12)  # a long step is no single step of the integrator
    close(run.rollout(x, 2, 30 * run.dt)[:, 2], run.rollout(x, 60)[:, 60], 1e-12)
    assert again.flow(x.numpy()).shape == (2, 2)
    position = run.results.row(Who("model", "true"))
    assert position is not None
    assert run.config["seed"] == 7


@pytest.mark.parametrize(
    ("call_it", "message"),
    [
        (lambda run: run.flow([[1.0, 2.0, 3.0]]), r"x: expected states \[q, p\].*received shape \(1, 3\)"),
        (lambda run: run.rollout("a", 3), r"start: expected numbers"),
        (lambda run: run.energy([0.1, 0.2]), r"energy: expected a Hamiltonian"),
    ],
)
def test_wrong_arguments_of_a_run_are_named(tmp_path_factory, call_it, message):
    folder = tmp_path_factory.getbasetemp() / "node"
    if not folder.exists():
        assert call("ahnn.train", "model=node", *SMALL, "evaluation.figures=false", f"run={folder}") == 0
    with pytest.raises(ValueError, match=message):
        call_it(ahnn.load(folder))


ORBIT = torch.tensor([[7000.0, 0.0, 0.0, 0.0, 7.5, 0.1]], dtype=torch.float64)
ASKED = {
    "three axes": (
        lambda run: run.rollout(ORBIT[None], 3),
        r"start: expected shape \(B, 6\); received \(1, 1, 6",
    ),
    "no start": (lambda run: run.rollout([], 3), r"start: expected states .* received shape \(0,\)"),
    "a mask": (
        lambda run: run.rollout(MASKED, 3),
        "start: expected finite numbers up to 1e150",
    ),
    "backwards": (lambda run: run.rollout(ORBIT, -1), "steps: expected a whole number >= 0; received -1"),
    "half a step": (lambda run: run.rollout(ORBIT, 2.5), "steps: .* received 2.5"),
    "too many": (lambda run: run.rollout(ORBIT, 10**13), "steps: expected predicted states that fit"),
    "no length": (
        lambda run: run.rollout(ORBIT, 3, torch.nan),
        "expected one finite number.* received nan",
    ),
    "lengths": (lambda run: run.rollout(ORBIT, 3, [60.0, 60.0]), r"shape \(1, 3\); received Tensor \(2,\)"),
    "length of a flow": (lambda run: run.flow(ORBIT, "60"), "dt: expected numbers in"),
    "lengths of a flow": (lambda run: run.flow(ORBIT, [60.0, 30.0]), r"shape \(1,\); received Tensor \(2,\)"),
    "starts of a prediction": (lambda run: run.predict(ORBIT[None], [0.0, 60.0]), r"start: expected shape"),
    "no run": (lambda _: ahnn.load(5), r"run: expected Path or str; received 5 \(int\)"),
    "no checkpoint": (lambda run: ahnn.load(run.folder, None), "ckpt: expected str; received None"),
}
MASKED = np.ma.masked_greater(ORBIT.numpy(), 100)


@pytest.fixture(scope="module")
def mechanical():
    return ahnn.load("molniya_mechanical")


@pytest.mark.parametrize("asked", ASKED)
def test_what_a_run_cannot_do_is_one_message(mechanical, asked):
    call_it, message = ASKED[asked]
    with pytest.raises(UserError, match=message):
        call_it(mechanical)


def test_starts_and_steps_of_every_kind_are_the_same(mechanical):
    expected = mechanical.rollout(ORBIT, 3)
    for start in (ORBIT.numpy().astype(">f8"), ORBIT.numpy().astype(object), [ORBIT[0]], ORBIT[0].tolist()):
        assert torch.equal(mechanical.rollout(start, 3), expected)
    for dt in (60, torch.tensor(60.0), np.float64(60), torch.full((1, 3), 60.0)):
        close(mechanical.rollout(ORBIT, torch.tensor(3), dt), expected, 1e-15)
    whole = mechanical.flow(torch.stack((ORBIT, 2 * ORBIT)))
    assert torch.equal(whole, torch.stack((mechanical.flow(ORBIT), mechanical.flow(2 * ORBIT))))


def test_gradients_flow_through_a_rollout_to_start_step_and_parameters(mechanical):
    """Against central differences of the rollout without gradients."""
    run = copy.deepcopy(mechanical)
    run.dynamics.requires_grad_()
    start, dt = ORBIT.clone().requires_grad_(), torch.tensor(60.0, dtype=torch.float64, requires_grad=True)
    run.rollout(start, 3, dt)[0, -1, 0].backward()
    for given, unit, step in (
        (start, torch.eye(6, dtype=torch.float64)[:1], 1e-3),
        (dt, torch.tensor(1.0), 1e-2),
    ):
        ends = []
        for sign in (1, -1):
            x, h = ORBIT.clone(), torch.tensor(60.0, dtype=torch.float64)
            (x if given is start else h).add_(sign * step * unit)
            ends.append(float(mechanical.rollout(x, 3, h)[0, -1, 0]))
        assert given.grad is not None
        assert float(given.grad.flatten()[0]) == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-6)
    assert sum(p.grad is not None for p in run.dynamics.parameters()) > 3
    assert not mechanical.rollout(ORBIT, 3).requires_grad


def test_a_run_can_be_copied_pickled_and_cast(mechanical):
    expected = mechanical.rollout(ORBIT, 3)
    for other in (copy.deepcopy(mechanical), pickle.loads(pickle.dumps(mechanical))):
        assert torch.equal(other.rollout(ORBIT, 3), expected)
    single = copy.deepcopy(mechanical)
    single.dynamics.float()
    close(single.rollout(ORBIT, 3), expected, 1e-5)
    expected = mechanical.predict(ORBIT, [0.0, 60.0]).states
    close(single.predict(ORBIT, [0.0, 60.0]).states, expected, 1e-6)
    single.dynamics.requires_grad_()
    close(single.predict(ORBIT, [0.0, 60.0]).states.detach(), expected, 1e-5)
    assert single.novelty(ORBIT).dtype == torch.float64


OVERRIDES = {
    "deleted data": (["~system"], "received ~system"),
    "another folder": (["++folder=x"], r"received \+\+folder=x"),
    "a sweep": (["sweep=pfl"], "received sweep=pfl"),
    "seeds": (["seeds=[1,2]"], r"received seeds=\[1,2\]"),
    "two values": (["seed=1,2"], "expected one value, since it trains once; received seed=1,2"),
    "a deleted group": (["~evaluation"], r"configuration: .*evaluation"),
    "an interpolation": (["label=${nope}"], r"Interpolation key 'nope' not found \(label\)"),
    "a key that nobody reads": (["+x=1"], "expected a key that is used"),
    "an option of the data": (["system.gap=0"], "system.gap: expected float >= 1.5; received 0"),
    "a text": ("model=hnn", "overrides: expected a list of strings"),
    "nothing": (None, "overrides: expected a list of strings .* received None"),
}


@pytest.mark.parametrize("wrong", OVERRIDES)
def test_overrides_that_make_no_training_are_one_message(tmp_path, wrong):
    overrides, message = OVERRIDES[wrong]
    with pytest.raises(UserError, match=message):
        ahnn.fit(oscillators(), SPACE, overrides, folder=tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("folder", ["", ".", None, 5, "a\0b"])
def test_a_fit_needs_a_folder(folder):
    with pytest.raises(UserError, match="folder: expected the path of a new folder; received"):
        ahnn.fit(oscillators(), SPACE, folder=folder)


def test_what_there_is_is_said(capsys, monkeypatch):
    from ahnn.__main__ import main

    monkeypatch.setattr("sys.argv", ["ahnn"])
    main()
    out = capsys.readouterr().out
    assert "python -m ahnn.train" in out
    assert "molniya_mechanical" in out
    assert max(map(len, out.splitlines())) <= 100
