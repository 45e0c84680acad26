"""Predictions of models whose forces depend on time or controls, in Python and from the command line."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from entry import SMALL, call
from helpers import close, generator

import ahnn
from ahnn.checkpoints import FORMAT, Weights, write_weights
from ahnn.controls import merged
from ahnn.data.files.control_table import read_controls
from ahnn.dynamics import make_dynamics
from ahnn.errors import UserError
from ahnn.jobs.control_times import known_controls
from ahnn.stored import about_space
from ahnn.types import Space, Units

DOUBLE = {"dtype": torch.float64}
CONF = Path(__file__).parents[1] / "motions" / "conf"
MASS = 1.5
TIMES = torch.tensor([0.5, 0.8, 1.5, 1.6, 3.0], **DOUBLE)
PUSHES = torch.tensor([[1.0], [-2.0], [0.5], [3.0], [7.0]], **DOUBLE)


def made(forces, controls=(), weights=0.0):
    torch.manual_seed(3)
    dynamics = make_dynamics(
        "hamiltonian",
        dof=1,
        inertia=MASS,
        hamiltonian="mechanical",
        mu=None,
        inputs="cartesian",
        scaling="none",
        network={"width": 12, "depth": 2, "activation": "tanh"},
        integrator={"name": "rk4"},
        forces=forces,
        controls=len(controls),
    ).double()
    for parameter in dynamics.parameters():
        parameter.data = weights * torch.randn(parameter.shape, generator=generator(4), **DOUBLE)
    space = Space("made", ("q", "p"), Units("s", "m", "m/s", "J"), inertia=MASS, controls=controls)
    return ahnn.Run(dynamics.frozen(), space, 0.2, {}, Path())


@pytest.fixture(scope="module")
def pushed():
    """A free mass under a control."""
    return made({"controls": {"kind": "actuation", "matrix": [[1.0]]}}, ("u",))


def test_sampled_paths_are_under_the_same_controls(pushed):
    """The force does not depend on the state, so that the mean is the path of the mean."""
    plain = pushed.predict([[0.0, 0.0], [1.0, 0.0]], TIMES, controls=PUSHES)
    found = pushed.predict(
        [[0.0, 0.0], [1.0, 0.0]], TIMES, controls=PUSHES, start_sd=[0.1, 0.2], samples=1000
    )
    close(found.states, plain.states, 1e-12)
    later = (0.1**2 + (0.2 / MASS * 2.5) ** 2) ** 0.5  # after 2.5 s
    assert float(found.deviations[1, -1, 0]) == pytest.approx(later, rel=0.06)


@pytest.mark.parametrize("linear", [False, True])
def test_a_free_mass_gains_the_integral_of_its_control(pushed, linear):
    found = pushed.predict([0.0, 0.0], TIMES, controls=PUSHES, linear=linear)
    gaps, u = TIMES.diff(), PUSHES[:, 0]
    impulse = gaps * ((u[:-1] + u[1:]) / 2 if linear else u[:-1])
    close(found.states[0, 1:, 1], impulse.cumsum(0), 1e-13)
    assert torch.equal(found.times, TIMES)


def test_the_covariance_of_a_start_is_that_of_a_free_mass_whatever_pushes_it(pushed):
    found = pushed.predict([0.0, 0.0], TIMES, start_sd=[0.1, 0.3], controls=PUSHES)
    gone = (TIMES - TIMES[0]) / MASS
    assert found.covariances is not None
    close(found.covariances[0, :, 0, 0], 0.01 + gone**2 * 0.09, 1e-6)
    close(found.covariances[0, :, 0, 1], gone * 0.09, 1e-6)


def test_a_covariance_under_a_drive_is_that_of_differences_of_predictions():
    run = made({"forcing": {"frequency": 2.0}, "friction": {}}, weights=0.5)
    start, sd, h = torch.tensor([[0.3, -0.2]], **DOUBLE), [0.1, 0.3], 1e-4
    found = run.predict(start, TIMES, start_sd=sd)
    near = torch.cat([start + h * torch.eye(2, **DOUBLE), start - h * torch.eye(2, **DOUBLE)])
    plus, minus = run.predict(near, TIMES).states.chunk(2)
    moved = ((plus - minus) / (2 * h)).permute(1, 2, 0) * torch.tensor(sd, **DOUBLE)
    assert found.covariances is not None
    close(found.covariances[0], moved @ moved.mT, 1e-5)
    later = run.predict(start, TIMES + 0.7)
    assert float((later.states - found.states).abs().max()) > 1e-3  # the clock counts


def test_each_start_may_have_controls_of_its_own(pushed):
    both = torch.stack([PUSHES, -PUSHES])
    found = pushed.predict([[0.0, 0.0], [0.0, 0.0]], TIMES, controls=both)
    close(found.states[0], -found.states[1], 1e-15)


@pytest.mark.parametrize("controls", [None, [[1.0]], [1.0] * 5, [[[1.0]] * 5] * 2])
def test_controls_that_are_none_are_refused(pushed, controls):
    with pytest.raises(UserError, match=r"controls: expected shape \(5, 1\), or one"):
        pushed.predict([0.0, 0.0], TIMES, controls=controls)
    with pytest.raises(UserError, match="None, since no force depends on controls; received shape"):
        made({"friction": {}}).predict([0.0, 0.0], TIMES, controls=PUSHES)
    with pytest.raises(UserError, match="controls: expected finite numbers up to 1e"):
        pushed.predict([0.0, 0.0], TIMES, controls=PUSHES * float("nan"))


def test_times_of_controls_are_met_and_no_step_is_a_rounding_error():
    times = torch.linspace(0.0, 1.0, 11, **DOUBLE)
    others = torch.tensor([-1.0, 0.0, 0.1 + 1e-13, 0.25, 0.9, 1.0, 7.0], **DOUBLE)
    found = merged(times, others)
    close(found, torch.cat((times[:3], torch.tensor([0.25], **DOUBLE), times[3:])), 1e-15)


def test_the_only_control_of_a_table_may_have_any_name_of_a_control(tmp_path):
    space = Space("made", ("q", "p"), controls=("u",))
    (tmp_path / "c.csv").write_text("t,torque_cmd\n0,1\n")
    assert read_controls(tmp_path / "c.csv", space).values.tolist() == [[1.0]]
    (tmp_path / "c.csv").write_text("t,u1,u2\n0,1,2\n")
    with pytest.raises(UserError, match="expected the control columns u; received t, u1, u2"):
        read_controls(tmp_path / "c.csv", space)


@pytest.fixture(scope="module")
def spring(tmp_path_factory):
    """A run that learned, badly, how a spring is pushed."""
    folder = tmp_path_factory.mktemp("runs") / "pushed"
    options = ["system=pushed_spring", "hamiltonian=mechanical", "forces=controls", "loss=recursive"]
    options += ["recipe=second_order", "evaluation=scores", "data.batch_size=100", "trainer.max_epochs=1"]
    assert call("ahnn.train", "--config-dir", str(CONF), f"run={folder}", *SMALL, *options) == 0
    return folder


def test_a_command_predicts_under_the_controls_of_a_file(spring, tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    Path("pushes.csv").write_text("t,u\n0,1\n0.12,-1\n0.2,0.5\n")
    Path("start.csv").write_text("t,q,v\n0,0.1,0\n0.05,0.2,0.1\n")
    words = ["ahnn.predict", f"run={spring}", "duration=0.3", "step=0.1"]
    assert call(*words, "start=start.csv", "controls=pushes.csv", "output=out.csv") == 0
    rows = [line.split(",") for line in Path("out.csv").read_text().splitlines()]
    named = dict(zip(rows[0], zip(*rows[1:], strict=True), strict=True))
    run = ahnn.load(spring)
    times = torch.tensor([0.0, 0.1, 0.12, 0.2, 0.3], **DOUBLE)
    pushes = torch.tensor([[1.0], [1.0], [-1.0], [0.5], [0.5]], **DOUBLE)
    told = run.predict([0.1, 0.0], times, controls=pushes).states[0, [0, 1, 3, 4], 0]
    close(torch.tensor([float(cell) for cell in named["q [m]"]], **DOUBLE), told, 1e-12)
    assert "the last values of pushes.csv, at 0.2, are held until the end, at 0.3" in caplog.text
    assert call(*words, "start=[0.1,0]", "controls=[1]", "output=held.csv") == 0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            ["start=[0.1,0]"],
            "controls: expected a FILE with time and u, or constant numbers; received None",
        ),
        (["start=[0.1,0]", "controls=[1,2]"], "received [1, 2]"),
        (
            ["start=[0.1,0]", "controls=none.csv"],
            "expected numbers or a file; received none.csv: No such",
        ),
    ],
)
def test_a_command_without_controls_says_what_is_missing(given, said, spring, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["ahnn.predict", f"run={spring}", "duration=0.3", "step=0.1", "output=out.csv"]
    assert call(*words, *given) == 2
    assert said in capsys.readouterr().err
    assert not Path("out.csv").exists()


def test_forces_of_time_take_no_controls_whatever_the_data_have():
    run = made({"forcing": {"frequency": 2.0}}, ("u",))
    assert known_controls(None, 0.0, run) is None
    for given in ([1.0], 1.0, "pushes.csv"):
        with pytest.raises(
            UserError, match=r"controls: expected none for .*, whose forces take none; received"
        ):
            known_controls(given, 0.0, run)


def test_a_model_without_controls_takes_none(capsys):
    words = ["ahnn.predict", "pretrained=molniya_mechanical", "start=[0,-3145,-6173,10,0,0]", "duration=60"]
    assert call(*words, "controls=[1]") == 2
    assert "controls: expected none" in capsys.readouterr().err


def test_a_unit_of_a_control_is_said_not_to_be_converted(tmp_path, caplog):
    (tmp_path / "c.csv").write_text("t,u [kN]\n0,1\n")
    read_controls(tmp_path / "c.csv", Space("made", ("q", "p"), controls=("u",)))
    assert "not converted, but assumed to be in the units of the training data: u [kN]" in caplog.text


def test_weights_whose_controls_are_not_those_of_the_space_are_refused(pushed, tmp_path):
    for names in ((), ("u", "w"), ("p",), ("",)):
        folder = tmp_path / f"run{names}"
        folder.mkdir()
        about = {"format": FORMAT, "dynamics": pushed.dynamics.spec, "dt": 0.2}
        about["space"] = about_space(pushed.space._replace(controls=names))
        write_weights(folder / "weights.safetensors", Weights(pushed.dynamics.state_dict(), about))
        with pytest.raises(
            UserError, match=r"space.controls: expected (1 names, for the controls|different names)"
        ):
            ahnn.load(folder)
