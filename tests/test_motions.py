"""What the contract can say, each in one file and one YAML: friction, masses, angles, known forces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from entry import SMALL, call
from helpers import close, generator
from motions.coupled_masses import CoupledMasses
from motions.forced_oscillator import ForcedOscillator
from motions.pushed_spring import PushedSpring
from motions.rotor import Rotor
from motions.weight import Weight
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import ahnn
from ahnn.clock import Clock, extended, reduced
from ahnn.data import Given
from ahnn.data.generate import generate
from ahnn.dynamics.flow_at_time import at, steered, wrapped
from ahnn.dynamics.forces import FORCES
from ahnn.errors import UserError
from ahnn.estimation import initial_belief
from ahnn.evaluation import load_results
from ahnn.measurements import reading
from ahnn.rollouts import rollout
from ahnn.systems import exact_flow
from ahnn_plugins.ekf import ExtendedKalmanFilter
from ahnn_plugins.enkf import EnsembleKalmanFilter
from ahnn_plugins.particle import ParticleFilter
from ahnn_plugins.ukf import UnscentedKalmanFilter

CONF = Path(__file__).parent / "motions" / "conf"
TINY = [*SMALL, "recipe=second_order", "data.batch_size=400", "evaluation=scores"]


def trained(folder, *options):
    assert call("ahnn.train", "--config-dir", str(CONF), f"run={folder}", *TINY, *options) == 0
    return ahnn.load(folder)


def reference(field, start, times):
    """The solution by SciPy's DOP853, (T, D)."""
    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12, "t_eval": times}
    return torch.from_numpy(solve_ivp(field, (times[0], times[-1]), start, **options).y.T.copy())


def test_a_forced_damped_oscillator_is_that_of_scipy():
    system = ForcedOscillator(name="f", dt=0.05, steps=200, mass=2.0)

    def field(t, x):
        q, p = x
        return p / 2.0, -5.0 * q - 0.4 * p / 2.0 + np.sin(1.3 * t)

    data = generate(system, 3, 0)
    for states, times in zip(data.states, data.times, strict=True):
        close(states, reference(field, states[0].numpy(), times.numpy()), 1e-9)
    assert not system.separable
    assert system.space.mechanical


def test_masses_that_differ_by_a_thousand_move_as_their_matrix_says():
    system = CoupledMasses(name="c", dt=0.05, steps=200)
    data = generate(system, 3, 0)
    matrix = np.zeros((4, 4))
    matrix[0, 2], matrix[1, 3] = 1.0, 1e-3
    matrix[2:, :2] = [[-4.0, 4.0], [4.0, -1004.0]]
    step = torch.from_numpy(expm(0.05 * matrix))
    exact = [data.states[:, 0]]
    for _ in range(200):
        exact.append(exact[-1] @ step.T)
    scales = system.space.scales
    close(data.states / scales, torch.stack(exact, 1) / scales, 1e-9)
    assert scales.tolist() == [1.0, 1.0, 1.0, 1000.0]


def test_a_training_learns_time_and_friction(tmp_path):
    forces = ["forces=[friction,forcing]", "model.forces.forcing.frequency=1.3"]
    options = ["system=forced_oscillator", "hamiltonian=mechanical", "data.windows_per_epoch=2000"]
    options += ["trainer.max_epochs=8", "callbacks.rollout.every=8"]
    run = trained(tmp_path / "run", *options, *forces)
    assert run.dynamics.clock == 1
    friction = run.dynamics.field.forces["friction"].coefficients()
    assert float(friction) == pytest.approx(0.4, rel=0.2)
    scores = load_results(tmp_path / "run").rows[0].scores
    start = torch.tensor([[0.5, 0.0]], dtype=torch.float64)
    late = run.rollout(start, 20, start_time=1.0)
    states = rollout(
        run.dynamics, start, 0.05, 21, clock=Clock.of(1.0 + 0.05 * torch.arange(21.0).double(), None)
    )
    close(late, states, 1e-12)
    assert float((late - run.rollout(start, 20)).abs().max()) > 0.1
    close(run.predict(start, 1.0 + 0.05 * torch.arange(21.0).double()).states, late, 1e-12)
    with pytest.raises(UserError, match="expected time in addition to the states"):
        run.flow(start)
    still = trained(tmp_path / "still", *options)
    assert scores.position < 0.2 * load_results(tmp_path / "still").rows[0].scores.position
    assert still.dynamics.clock == 0


def test_a_training_divides_each_momentum_by_its_own_mass(tmp_path):
    run = trained(tmp_path / "run", "system=coupled_masses", "hamiltonian=mechanical", "scaling=minmax")
    assert run.space.inertia == (1.0, 1000.0)
    x = torch.tensor([[0.1, 0.2, 0.3, 400.0]], dtype=torch.float64)
    close(run.dynamics.field(x)[:, :2], torch.tensor([[0.3, 0.4]], dtype=torch.float64), 1e-15)
    components = load_results(tmp_path / "run").rows[0].scores.components
    assert components[3] < 10  # a velocity: the momentum is a thousand times as large


def test_a_learned_force_has_the_period_of_an_angle(tmp_path):
    run = trained(tmp_path / "run", "system=rotor", "hamiltonian=mechanical", "inputs=angles")
    x = torch.tensor([[0.4, 8.0]], dtype=torch.float64)
    turned = x + torch.tensor([[20 * torch.pi, 0.0]], dtype=torch.float64)
    close(run.dynamics.field(turned), run.dynamics.field(x), 1e-12)
    data = generate(Rotor(name="r", dt=0.01, steps=1000), 4, 0)
    assert float(data.states[..., 0].abs().max()) > 50


def test_a_known_force_stands_beside_a_learned_one(tmp_path, monkeypatch):
    monkeypatch.setitem(FORCES.own, "weight", Weight)
    run = trained(
        tmp_path / "run", "hamiltonian=mechanical", "forces=[weight]", "model.forces.weight.force=[2.0]"
    )
    x = torch.tensor([[0.3, 0.1]], dtype=torch.float64)
    field = run.dynamics.field
    close(field(x)[:, 1] - field.hamiltonian(x)[:, 1], torch.tensor([2.0], dtype=torch.float64), 1e-12)
    close(run.energy(x) - field.hamiltonian.energy(x), torch.tensor([-0.6], dtype=torch.float64), 1e-12)
    assert "known weight" in run.dynamics.assumes
    assert float(field(x)[0, 1]) == pytest.approx(-1.5, abs=0.5)  # the learned part undoes the weight


@pytest.mark.parametrize(("stiffness", "better"), [(5.0, False), (4.0, True)])
@pytest.mark.sampled(2)
def test_known_physics_stays_the_result_where_no_later_weights_are_better(tmp_path, stiffness, better):
    """The system's own spring leaves at most the error of the integrator; a soft one leaves more."""
    spring = ["hamiltonian=mechanical", "forces=springs", f"model.forces.springs.stiffness={stiffness}"]
    judged = ["callbacks.rollout.count=5", "callbacks.best.monitor=val/rollout"]
    run = trained(tmp_path / "run", *spring, *judged)
    x = torch.tensor([[0.3, 0.1]], dtype=torch.float64)
    learned = float(run.dynamics.field.hamiltonian(x)[0, 1])
    assert learned == (pytest.approx(-0.3, abs=0.05) if better else pytest.approx(0.0, abs=1e-6))


FILTERS = {"ukf": UnscentedKalmanFilter(), "ekf": ExtendedKalmanFilter()}
FILTERS |= {"enkf": EnsembleKalmanFilter(), "particle": ParticleFilter(particles=400)}


TRIED = [pytest.param(name, marks=pytest.mark.slow if name == "particle" else ()) for name in FILTERS]


@pytest.mark.parametrize("name", TRIED)
@pytest.mark.sampled(3)
def test_filters_follow_a_force_that_depends_on_time(name):
    """Exact dynamics: errors are those that the filter believes; a flow that stands still in time is off."""
    system = ForcedOscillator(name="f", dt=0.05, steps=200)
    data, flow = generate(system, 30, 0), exact_flow(system)
    sd = torch.tensor([1e-2], dtype=torch.float64)
    noise = 1e-2 * torch.randn(30, 200, 1, generator=generator(1), dtype=torch.float64)
    rows = data.states[:, 1:, :1] + noise
    belief = initial_belief(data.states[:, 0], torch.diag(torch.tensor([1e-2, 1e-2]).double() ** 2))
    off = 1e-2 * torch.randn(30, 2, generator=generator(2), dtype=torch.float64)
    belief = belief._replace(mean=belief.mean + off)
    own = FILTERS[name]
    q = 1e-14 * torch.eye(2, dtype=torch.float64)
    arguments = (belief, rows, reading("position", system.space), q, torch.diag(sd**2), 0.05)
    result = own.run(flow, *arguments)
    errors = result.means - data.states[:, 1:]
    deviations = result.covariances.diagonal(dim1=-2, dim2=-1).sqrt()
    assert 0.8 < float((errors / deviations).square().mean().sqrt()) < 1.2
    frozen = own.run(lambda x, dt: at(flow, 0.0)(x, dt), *arguments)
    assert float((frozen.means - data.states[:, 1:]).norm()) > 5 * float(errors.norm())
    with pytest.raises(UserError, match="expected the time at which a step begins"):
        wrapped(flow, lambda inner: inner)(data.states[:, 0], 0.05)


@pytest.mark.parametrize("name", TRIED)
@pytest.mark.sampled(2)
def test_filters_follow_controls_that_are_known(name):
    """Each member has controls of its own, and those of another lead it astray."""
    system = PushedSpring(name="p", dt=0.05, steps=200)
    data, sd = generate(system, 30, 0), 1e-2
    assert data.controls is not None
    noise = sd * torch.randn(30, 200, 1, generator=generator(1), dtype=torch.float64)
    off = sd * torch.randn(30, 2, generator=generator(2), dtype=torch.float64)
    belief = initial_belief(data.states[:, 0] + off, sd**2 * torch.eye(2, dtype=torch.float64))
    own = FILTERS[name]
    q = 1e-14 * torch.eye(2, dtype=torch.float64)
    rows, r = data.states[:, 1:, :1] + noise, sd**2 * torch.eye(1, dtype=torch.float64)
    arguments = (belief, rows, reading("position", system.space), q, r, 0.05)
    flow = steered(exact_flow(system), data.times[0], data.controls)
    result = own.run(flow, *arguments)
    errors = result.means - data.states[:, 1:]
    deviations = result.covariances.diagonal(dim1=-2, dim2=-1).sqrt()
    assert 0.8 < float((errors / deviations).square().mean().sqrt()) < 1.2
    wrong = steered(exact_flow(system), data.times[0], data.controls.flip(0))
    assert float((own.run(wrong, *arguments).means - data.states[:, 1:]).norm()) > 5 * float(errors.norm())


def test_known_controls_are_held_or_interpolated_between_samples():
    flow = exact_flow(PushedSpring(name="p", dt=0.05, steps=20))
    x, times = torch.tensor([[0.3, -0.2]], dtype=torch.float64), [0.0, 0.1, 0.2]
    held, ramp = (steered(flow, times, [[1.0], [3.0], [5.0]], linear=linear) for linear in (False, True))
    for where, u, rate in ((0.05, 1.0, 0.0), (0.1, 3.0, 0.0), (9.0, 5.0, 0.0)):
        clock = Clock(torch.tensor([[where, u]]).double(), torch.tensor([[1.0, rate]]).double())
        close(at(held, where)(x, 0.05), reduced(flow(extended(x, clock), 0.05), 2), 1e-14)
    clock = Clock(torch.tensor([[0.05, 2.0]]).double(), torch.tensor([[1.0, 20.0]]).double())
    close(at(ramp, 0.05)(x, 0.05), reduced(flow(extended(x, clock), 0.05), 2), 1e-14)
    with pytest.raises(UserError, match="expected the time at which a step begins"):
        held(x, 0.05)
    expected = r"steered: expected finite, increasing times \(T,\) and controls \(T, 1\)"
    for given in ([[1.0], [3.0]], [[1.0], [float("nan")], [5.0]]):
        with pytest.raises(UserError, match=expected):
            steered(flow, times, given)
    three = steered(flow, times, [[[1.0], [3.0], [5.0]]] * 3)
    with pytest.raises(UserError, match="expected states of 3 members, as in the controls; received 1"):
        at(three, 0.05)(x, 0.05)
    with pytest.raises(UserError, match="steered: expected a flow with controls"):
        steered(exact_flow(ForcedOscillator(name="f", dt=0.05, steps=2)), times, [[1.0], [3.0], [5.0]])


def test_controls_that_no_force_takes_are_said(tmp_path, capsys):
    words = ["system=pushed_spring", "hamiltonian=mechanical", "loss=recursive", "trainer.max_epochs=1"]
    trained(tmp_path / "run", *words)
    said = "the controls u in the data have no effect in this model; forces=controls uses them"
    assert said in capsys.readouterr().err


def test_a_training_learns_how_controls_push(tmp_path, capsys):
    options = ["system=pushed_spring", "hamiltonian=mechanical", "forces=controls", "trainer.max_epochs=6"]
    options += ["data.trajectories=60", "data.windows_per_epoch=4000", "data.batch_size=1000"]
    options += ["callbacks.rollout.every=6"]
    words = ["ahnn.train", "--config-dir", str(CONF), f"run={tmp_path / 'none'}", *TINY, *options]
    assert call(*words) == 2
    assert "loss.derivative: expected 0 with controls" in capsys.readouterr().err
    options.append("loss=recursive")
    run = trained(tmp_path / "run", *options)
    assert run.space.controls == ("u",)
    matrix = run.dynamics.field.forces["controls"].matrix(torch.zeros(1, 1, dtype=torch.float64))
    assert float(matrix) == pytest.approx(2.0, rel=0.25)  # it begins at 0
    start, pushes = torch.zeros(1, 2, dtype=torch.float64), torch.tensor([[1.0], [-1.0], [0.0]]).double()
    away = run.rollout(start, 3, controls=pushes)
    assert away[0, 1, 1] > 0 > away[0, 2, 1] - away[0, 1, 1]
    close(run.rollout(start, 3, controls=pushes[None]), away, 1e-15)
    with pytest.raises(UserError, match=r"controls: expected shape \(3, 1\), or one .*; received None"):
        run.rollout(start, 3)
    (floor,) = [r for r in load_results(tmp_path / "run").rows if r.who.floor and r.who.start == "true"]
    assert floor.scores.position < 1e-4  # it knows the pushes


def test_pushes_that_are_held_are_those_of_the_exact_solution():
    """Between samples q'' = -5 q + 2 u: a rotation about 2 u / 5."""
    system = PushedSpring(name="p", dt=0.05, steps=100)
    data = generate(system, 4, 0)
    w = 5**0.5
    c, s = np.cos(0.05 * w), np.sin(0.05 * w)
    middle = torch.cat((0.4 * data.controls[:, :-1], torch.zeros(4, 100, 1, dtype=torch.float64)), dim=-1)
    turn = torch.tensor([[c, s / w], [-s * w, c]], dtype=torch.float64)
    close(data.states[:, 1:], middle + (data.states[:, :-1] - middle) @ turn.T, 1e-11)


def test_controls_are_never_dropped():
    states, times = torch.randn(4, 9, 2, dtype=torch.float64), torch.arange(9.0).double()
    with pytest.raises(UserError, match=r"controls: expected shape .*names none; received Tensor"):
        Given(ahnn.Trajectories(states, times, torch.zeros(4, 9, 1)), ahnn.Space("s", ("q", "p")))
    run = ahnn.load("molniya_mechanical")
    with pytest.raises(UserError, match="controls: expected None"):
        run.rollout(torch.ones(6), 2, controls=[[1.0], [1.0]])
