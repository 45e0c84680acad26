"""A package that extends ahnn in seven places is installed, found and used; docs/extending.md shows it."""

from __future__ import annotations

import importlib
import re
import shlex
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest
import torch
from entry import call, untouched
from helpers import close, generator
from hydra.core.plugins import Plugins

import ahnn
from ahnn.dynamics import KINDS, make_dynamics
from ahnn.errors import UserError
from ahnn.estimation import initial_belief
from ahnn.extensions import Table
from ahnn.integrators import INTEGRATORS
from ahnn.measurements import State
from ahnn.training import Loss, LossOptions
from ahnn.training.curriculum import make_curriculum
from ahnn.training.objectives import OBJECTIVES
from ahnn.types import Window
from ahnn_plugins.ukf import UnscentedKalmanFilter

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "tests" / "extension"
PAGE = (ROOT / "docs" / "extending.md").read_text()
LINES = re.findall(r"^python .*$", PAGE.replace("\\\n", ""), re.MULTILINE)
COMMANDS = [re.split(r"\s#\s", line)[0].strip() for line in LINES]
SMALL = ["system.steps=60", "data.trajectories=20", "data.windows_per_epoch=200", "data.batch_size=100"]
SMALL += ["data.val_windows=40", "trainer.max_epochs=1", "evaluation=scores", "logger=none"]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder in which the package is installed."""
    pytest.importorskip("hatchling", reason="the package is built without network")
    folder = tmp_path_factory.mktemp("site")
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--disable-pip-version-check", "--no-index"]
    command = [sys.executable, "-m", "pip", "install", *options, "--target", str(folder), str(PACKAGE)]
    subprocess.run(command, check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def installed(site):
    """The package as an environment has it; afterwards nothing of it is left in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [str(site), *sys.path])
        importlib.invalidate_caches()
        Plugins.instance()._initialize()
        yield site
    for name in [name for name in sys.modules if "duffing" in name]:
        del sys.modules[name]
    importlib.invalidate_caches()
    Plugins.instance()._initialize()


@pytest.fixture(scope="module")
def trained(installed, tmp_path_factory):
    """The run of the first command of the page, with small amounts."""
    assert installed.is_dir()
    place = tmp_path_factory.mktemp("trained")
    words = shlex.split(COMMANDS[0])
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        assert call(words[2], *words[3:], *SMALL) == 0
    return place / "runs" / "mine"


def test_a_run_with_all_of_it_is_evaluated_again_with_no_word_of_trust(trained, monkeypatch, capsys):
    results = ahnn.load(trained).results
    assert {row.who.estimator for row in results.rows} == {None, "ekf"}
    assert results.numbers["first_order"]["measured"] == ["bearing"]
    assert any(row.who.process == "exact field, ralston" for row in results.rows)
    words = shlex.split(COMMANDS[1])
    monkeypatch.chdir(trained.parents[1])
    assert call(words[2], *words[3:], "name=again") == 0
    assert "newton + UKF" in capsys.readouterr().out
    (again,) = (trained / "evaluations").iterdir()
    again = ahnn.evaluation.load_results(again)
    assert again.numbers["ukf"]["measured"] == ["bearing"]
    assert [row.scores for row in again.rows[:2]] == [row.scores for row in results.rows[:2]]


def test_its_dynamics_are_loaded_in_python(trained):
    run = ahnn.load(trained)
    assert type(run.dynamics).__name__ == "Newton"
    assert run.rollout([[0.5, 0.0]], steps=10).shape == (1, 11, 2)


@pytest.mark.usefixtures("installed")
def test_the_map_is_trained_and_has_the_step_of_its_data(tmp_path, capsys):
    run = f"run={tmp_path / 'map'}"
    small = [*SMALL, "plugins=none", "optimizer=adamw"]
    assert call("ahnn.train", "system=mass_spring", "model=linear_map", run, *small) == 0
    assert "linear on mass_spring: linear map" in capsys.readouterr().out
    dynamics, dt = ahnn.load(tmp_path / "map").dynamics, 0.01
    x = torch.tensor([[0.5, -0.2]], dtype=torch.float64)
    assert dynamics.own_step == pytest.approx(dt)
    close(dynamics(x, dt) - x, dynamics.matrix(x), 1e-12)
    with pytest.raises(UserError, match=r"expected the step used in training, 0\.01"):
        dynamics(x, 2 * dt)


@pytest.mark.usefixtures("installed")
def test_help_lists_its_options_and_a_name_beside_them_is_corrected(capsys):
    assert call("ahnn.train", "--help") == 0
    out = capsys.readouterr().out
    for name in ("hardening", "newton", "ralston", "endpoint", "bearing", "first_order"):
        assert f" {name}" in out
    assert call("ahnn.train", "--help", "loss=endpoint") == 0
    assert "states at the end that count" in capsys.readouterr().out
    assert call("ahnn.train", "integrator=ralstn") == 2
    assert "did you mean 'ralston'?" in capsys.readouterr().err


def test_without_the_package_the_missing_name_is_said(trained, monkeypatch, capsys):
    monkeypatch.setattr(sys, "path", [path for path in sys.path if "site0" not in path])
    assert not entry_points(group="ahnn.dynamics")
    assert call("ahnn.evaluate", f"run={trained}") == 2
    err = capsys.readouterr().err
    assert "received 'newton'. Installed packages add kinds" in err
    with pytest.raises(UserError, match=r"objective: expected one of recursive, fitted_starts; rec"):
        make_curriculum(2, 4, {"objective": "endpoint"})
    with pytest.raises(UserError, match=r"integrator: expected one of euler, .*received 'ralston'"):
        make_dynamics(
            "node", dof=1, scaling="none", network={"width": 4, "depth": 1}, integrator={"name": "ralston"}
        )


@pytest.mark.usefixtures("installed")
def test_tables_know_what_is_declared_and_keep_their_own():
    assert {"newton", "linear_map"} == KINDS.keys() - KINDS.own.keys()
    assert {"ralston"} == INTEGRATORS.keys() - INTEGRATORS.own.keys()
    assert {"endpoint"} == OBJECTIVES.keys() - OBJECTIVES.own.keys()
    assert len(KINDS) == len(KINDS.own) + 2
    ours = Table("ahnn.dynamics", {"newton": 1})
    assert (ours["newton"], {*ours}) == (1, {"newton", "linear_map"})
    assert "no such" not in ours


@pytest.mark.usefixtures("installed")
def test_an_option_of_an_objective_that_it_has_not_is_refused():
    with pytest.raises(UserError, match=r"loss\.options: unknown key 'lst'; did you mean 'last'\?"):
        make_curriculum(2, 4, {"objective": "endpoint", "options": {"lst": 1}})
    with pytest.raises(UserError, match=r"loss\.options\.last: expected int >= 1; received 0"):
        make_curriculum(2, 4, {"objective": "endpoint", "options": {"last": 0}})


@pytest.mark.usefixtures("installed")
def test_the_objective_has_one_sum_of_squares_for_gradients_and_second_order_steps():
    torch.manual_seed(0)
    network = {"width": 4, "depth": 1}
    options = {"inertia": 1.0, "scaling": "none", "network": network, "integrator": {"name": "ralston"}}
    dynamics = make_dynamics("newton", dof=1, **options).double()
    draws = torch.randn(5, 5, 2, generator=generator(0), dtype=torch.float64)
    batch = Window(draws[:, 0], 0.1 * draws[:, 1:], 0.1)
    objective = OBJECTIVES["endpoint"](Loss(2, LossOptions()).double(), 4, last=2)
    residuals = objective.residuals(dynamics, batch)
    theta = torch.cat([part.detach().flatten() for part in dynamics.parameters()])
    problem = objective.problem(dynamics, batch)
    assert residuals.shape == (5, 2, 2)
    close(problem.loss(theta), residuals.square().sum(), 1e-12)
    problem.loss(theta)
    gradients = torch.autograd.grad(residuals.square().sum() / 2, list(dynamics.parameters()))
    by_hand = problem.jacobian(theta).double().T @ problem.residuals(theta)
    close(by_hand, torch.cat([part.flatten() for part in gradients]), 1e-5)


@pytest.mark.usefixtures("installed")
def test_the_integrator_is_of_third_order():
    def field(x):
        return torch.stack((x[..., 1], -torch.sin(x[..., 0])), dim=-1)

    def end(name, steps):
        x = torch.tensor([[1.0, 0.0]], dtype=torch.float64)
        for _ in range(steps):
            x = INTEGRATORS[name].step(field, x, 2.0 / steps)
        return x

    exact = end("dopri8", 200)
    coarse, fine = (float((end("ralston", steps) - exact).norm()) for steps in (40, 80))
    assert 7.0 < coarse / fine < 9.0


@pytest.mark.usefixtures("installed")
def test_the_estimator_is_the_kalman_filter_on_a_linear_system():
    """The unscented filter is one too; measurements are missing in part."""
    from duffing.estimator import ExtendedKalmanFilter

    turn = torch.tensor([[0.9, 0.4], [-0.4, 0.95]], dtype=torch.float64)
    q, r = torch.diag(torch.tensor([0.02, 0.01])).double(), torch.tensor([[0.2, 0.05], [0.05, 0.3]]).double()
    rows = torch.randn(3, 6, 2, generator=generator(1), dtype=torch.float64)
    rows[0, 2, 0] = rows[1, 3, 1] = rows[2, 4, :] = torch.nan
    filters = ExtendedKalmanFilter(), UnscentedKalmanFilter()
    start = initial_belief(
        torch.randn(3, 2, generator=generator(2), dtype=torch.float64), torch.eye(2).double()
    )
    states = [each.start(start) for each in filters]
    for row in rows.unbind(1):
        told = []
        for k, each in enumerate(filters):
            state = each.predict(states[k], lambda x, dt: x @ (turn * dt).T, 1.0, q)
            states[k], innovation = each.update(state, row, State(1), r)
            told.append(innovation)
        there = ~told[1].nis.isnan()
        close(told[0].nis[there], told[1].nis[there], 1e-10)
        assert torch.equal(told[0].nis.isnan(), ~there)
        close(told[0].log_likelihood, told[1].log_likelihood, 1e-10)
        close(states[0].belief.mean, states[1].belief.mean, 1e-10)
        close(states[0].belief.covariance, states[1].belief.covariance, 1e-10)


@pytest.mark.usefixtures("installed")
def test_the_measurement_is_located_where_it_was_seen():
    from duffing.measurement import Bearing

    x = torch.randn(7, 2, generator=generator(3), dtype=torch.float64)
    close(Bearing(2.0).locate(Bearing(2.0)(x, 0.0), 0.0), x[:, :1], 1e-14)
    with pytest.raises(UserError, match="distance: expected float > 0; received 0"):
        Bearing(0)


def test_the_page_includes_every_file_of_the_package():
    shown = re.findall(r'^--8<-- "tests/extension/([\w./]+)"$', PAGE, re.MULTILINE)
    files = [path for path in PACKAGE.rglob("*.*") if path.suffix in (".py", ".yaml", ".toml")]
    assert sorted(shown) == sorted(str(f.relative_to(PACKAGE)) for f in files if f.name != "__init__.py")


@pytest.mark.slow
def test_the_commands_of_the_page_run_as_printed(site, tmp_path, monkeypatch):
    paths = [str(ROOT), str(ROOT / "plugins"), str(site)]
    monkeypatch.setenv("PYTHONPATH", ":".join(paths))
    printed = PAGE[PAGE.index("newton on hardening") :].splitlines()[0]
    for command in COMMANDS:
        words = [sys.executable, *shlex.split(command)[1:]]
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert printed in done.stdout
    with untouched():
        assert (tmp_path / "runs" / "mine" / "evaluations").is_dir()
