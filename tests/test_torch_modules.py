"""Dynamics as torch users expect modules: built in one call, differentiated, copied, trained in any loop."""

from __future__ import annotations

import copy
import io
import pickle

import pytest
import torch
from helpers import close, generator
from torch.func import functional_call, jacrev, vmap
from torch.utils.data import DataLoader, TensorDataset

import ahnn
from ahnn.dynamics.energy_levels import scale, units_of
from ahnn.dynamics.layered import silence
from ahnn.errors import UserError

DOUBLE = {"dtype": torch.float64}
MADE = {
    "generic": lambda: ahnn.Hamiltonian(2, 8),
    "separable": lambda: ahnn.Hamiltonian(2, 8, structure="separable", integrator="yoshida4"),
    "mechanical": lambda: ahnn.Hamiltonian(2, 8, structure="mechanical", inertia=[1.0, 2.0]),
    "mass_matrix": lambda: ahnn.Hamiltonian(2, 8, structure="mass_matrix"),
    "lagrangian": lambda: ahnn.Lagrangian(2, 8, depth=1),
    "node": lambda: ahnn.NeuralODE(2, 8),
    "sympnet": lambda: ahnn.FlowMap(2, 8, dt=0.1),
    "henon_net": lambda: ahnn.FlowMap(2, 8, dt=0.1, kind="henon_net"),
    "generalised_hnn": lambda: ahnn.FlowMap(2, 8, dt=0.1, kind="generalised_hnn"),
    "map": lambda: ahnn.FlowMap(2, 8, dt=0.1, kind="map"),
}
START = torch.randn(3, 4, generator=generator(0), **DOUBLE)


def free(mass=2.0):
    """A particle without force, whose motion is q + p t / m."""
    model = ahnn.Hamiltonian(1, 8, structure="mechanical", inertia=mass).double()
    silence(model)
    return model


def oscillators(count=20, samples=60):
    """Exact trajectories of H = (p^2 + q^2) / 2."""
    t = 0.1 * torch.arange(samples, **DOUBLE)
    a, phase = torch.rand(2, count, 1, generator=generator(1), **DOUBLE)
    angle = t + 6 * phase
    return ahnn.Trajectories(torch.stack(((0.5 + a) * angle.cos(), -(0.5 + a) * angle.sin()), -1), t)


@pytest.mark.parametrize("name", MADE)
def test_copies_pickles_and_restored_weights_are_the_same_module(name):
    model = MADE[name]()
    torch.save(model.state_dict(), content := io.BytesIO())
    content.seek(0)
    other = MADE[name]()
    assert not torch.equal(model(START.float(), 0.1), other(START.float(), 0.1))
    other.load_state_dict(torch.load(content, weights_only=True))
    for same in (other, copy.copy(model), copy.deepcopy(model), pickle.loads(pickle.dumps(model))):
        assert torch.equal(same(START.float(), 0.1), model(START.float(), 0.1))
        assert repr(same) == repr(model)
    close(model.double()(START, 0.1).float(), other(START.float(), 0.1), 1e-5)
    assert "\n" not in repr(model)
    assert "dof=2" in repr(model)


@pytest.mark.parametrize("name", MADE)
def test_gradients_of_a_rollout_are_differences_of_rollouts(name):
    torch.manual_seed(0)
    model, start = MADE[name]().double(), START.clone().requires_grad_()
    towards, way = torch.randn(2, 3, 4, generator=generator(2), **DOUBLE)
    (model.rollout(start, 3, 0.1)[:, -1] * towards).sum().backward()
    weight = next(p for p in model.parameters() if p.ndim == 2)
    for given, direction in ((start, way), (weight, torch.ones_like(weight))):
        ends = []
        for h in (1e-5, -1e-5):
            with torch.no_grad():
                given.add_(h * direction)
                ends.append(float((model.rollout(start, 3, 0.1)[:, -1] * towards).sum()))
                given.sub_(h * direction)
        expected = (ends[0] - ends[1]) / 2e-5
        assert given.grad is not None
        assert float((given.grad * direction).sum()) == pytest.approx(expected, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("name", MADE)
def test_function_transforms_see_the_same_module(name):
    model = MADE[name]().double()
    jacobians = vmap(jacrev(lambda x: model(x[None], 0.1)[0]))(START)
    whole = torch.autograd.functional.jacobian(lambda x: model(x, 0.1).sum(0), START)
    close(jacobians, whole.transpose(0, 1), 1e-12)
    of_weights = jacrev(lambda p: functional_call(model, p, (START, 0.1)))(dict(model.named_parameters()))
    assert {key: value.shape[2:] for key, value in of_weights.items()} == {
        key: value.shape for key, value in model.named_parameters()
    }


def test_the_flow_of_a_free_particle_is_its_closed_form():
    model, x = free(), torch.tensor([[0.5, 3.0], [1.0, -1.0]], **DOUBLE)
    path = model.rollout(x, 4, torch.full((2, 4), 0.25, **DOUBLE))
    close(path[:, -1], torch.stack((x[:, 0] + x[:, 1] / 2.0, x[:, 1]), -1), 1e-14)
    close(model(model(x, 0.3), -0.3), x, 1e-14)
    jacobian = jacrev(lambda x: model(x[None], 0.3)[0])(x[0])
    close(jacobian, torch.tensor([[1.0, 0.15], [0.0, 1.0]], **DOUBLE), 1e-14)


@pytest.mark.parametrize("name", ["generic", "separable", "mechanical", "mass_matrix"])
def test_the_field_is_the_gradient_of_the_energy(name):
    model, x = MADE[name]().double(), START.clone().requires_grad_()
    (slope,) = torch.autograd.grad(model.energy(x).sum(), x)
    close(model.field(START), torch.cat((slope[:, 2:], -slope[:, :2]), -1), 1e-12)


def test_compiled_and_meta_modules_are_modules_too():
    model = MADE["generic"]().double()
    close(torch.compile(model, backend="eager")(START, 0.1), model(START, 0.1), 1e-14)
    assert model.to("meta")(START.to("meta"), 0.1).shape == START.shape


def test_data_set_scales_and_a_plain_loop_learns_the_oscillator(tmp_path):
    """Against the closed form of unseen trajectories."""
    torch.manual_seed(0)
    data = oscillators()
    model = ahnn.Hamiltonian(dof=1, hidden=16, data=data).double()
    pairs = TensorDataset(data.states[:, :-1].flatten(0, 1), data.states[:, 1:].flatten(0, 1))
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-2)
    for _ in range(8):
        for x, target in DataLoader(pairs, batch_size=100, shuffle=True):
            optimizer.zero_grad()
            (model(x, 0.1) - target).square().mean().backward()
            optimizer.step()
    run = ahnn.save(model, ahnn.Space("oscillator", ("q", "p")), 0.1, tmp_path / "run", data)
    t = 0.1 * torch.arange(21, **DOUBLE)
    expected = torch.stack((t.cos(), -t.sin()), -1)
    close(run.rollout([1.0, 0.0], 20)[0], expected, 0.1)
    assert torch.equal(ahnn.load(tmp_path / "run").rollout([1.0, 0.0], 20), run.rollout([1.0, 0.0], 20))
    assert torch.equal(run.rollout([1.0, 0.0], 20)[0], model.rollout(expected[:1], 20, 0.1)[0])
    assert float(run.novelty([3.0, 0.0])) > 1 > float(run.novelty(data.states[0, :5]).median())


def test_a_map_takes_its_step_from_data():
    data = oscillators()
    assert ahnn.FlowMap(1, 4, data=data).own_step == pytest.approx(0.1, rel=1e-12)
    assert ahnn.FlowMap(1, 4, data=data, dt=0.2).own_step == pytest.approx(0.2, rel=1e-12)


def test_a_copy_keeps_the_units_of_parameters():
    model = ahnn.Hamiltonian(2, 4)
    weight = model.field.network.output.weight
    scale(weight, torch.full_like(weight, 0.5))
    same = copy.deepcopy(model)
    expected, received = units_of(model.parameters()), units_of(same.parameters())
    assert expected is not None
    assert received is not None
    assert torch.equal(received, expected)
    scale(weight, torch.full_like(weight, 0.25))
    assert torch.equal(units_of(same.parameters()), expected)


WRONG = {
    "no degree": (lambda: ahnn.Hamiltonian(dof=0), "dof: expected int >= 1; received 0"),
    "text": (lambda: ahnn.NeuralODE(dof="2"), "dof: expected int >= 1; received '2'"),
    "structure": (lambda: ahnn.Hamiltonian(2, structure="x"), "structure: expected one of generic, .*'x'"),
    "option": (
        lambda: ahnn.Hamiltonian(2, mass=1.0),
        "Hamiltonian: unknown option 'mass'.* takes dof, hidden",
    ),
    "option of another kind": (
        lambda: ahnn.FlowMap(2, dt=0.1, kind="map", layers=3),
        "FlowMap: unknown option 'layers'.*residual$",
    ),
    "angles": (lambda: ahnn.Hamiltonian(2, inputs="angles"), r"set angular, such as \[True, False\]"),
    "integrator": (lambda: ahnn.NeuralODE(2, integrator="rk5"), "'rk5'; did you mean rk4?"),
    "leapfrog": (lambda: ahnn.Hamiltonian(2, integrator="leapfrog"), "expected a separable Hamiltonian"),
    "masses": (lambda: ahnn.Lagrangian(2, inertia=[1.0] * 3), "inertia: expected one mass, or 2"),
    "step": (lambda: ahnn.FlowMap(2), "FlowMap: expected the step of the map as dt, or data"),
    "backward map": (lambda: ahnn.FlowMap(2, dt=-0.1), "dt: expected float > 0 or None; received -0.1"),
    "other step": (lambda: ahnn.FlowMap(2, dt=0.1)(START.float(), 0.2), "expected the step used in training"),
    "map": (lambda: ahnn.FlowMap(2, dt=0.1, kind="mlp"), "kind: expected one of sympnet"),
    "list": (lambda: ahnn.NeuralODE(1)([[1.0, 2.0]], 0.1), "a tensor with 2 components .* received list"),
    "states": (lambda: ahnn.NeuralODE(1)(START, 0.1), r"with 2 components .* received Tensor \(3, 4\)"),
    "steps": (lambda: ahnn.NeuralODE(2)(START.float(), torch.ones(2)), r"dt: .* each state; .*\(2,\)"),
    "steps of one": (lambda: ahnn.NeuralODE(2)(START[:1].float(), torch.ones(4)), r"dt: .* state; .*\(4,\)"),
    "column of steps": (lambda: ahnn.NeuralODE(2)(START.float(), torch.ones(3, 1)), "dt: expected a number"),
    "data": (lambda: ahnn.NeuralODE(2, data=START), "trajectories: expected ahnn.Trajectories"),
    "other data": (lambda: ahnn.NeuralODE(2, data=oscillators()), "data: expected states .* of 4|received"),
    "constant": (
        lambda: ahnn.Hamiltonian(1, data=ahnn.Trajectories(torch.ones(1, 5, 2), torch.arange(5.0))),
        "expected components that vary",
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_arguments_are_one_message(wrong):
    call_it, message = WRONG[wrong]
    with pytest.raises(UserError, match=message):
        call_it()


@pytest.mark.parametrize("option", ["hamiltonian", "network"])
def test_an_argument_has_one_name(option):
    with pytest.raises(UserError, match=f"Hamiltonian: unknown option '{option}'.* takes .*structure"):
        ahnn.Hamiltonian(2, **{option: "separable"})


PATHS = {
    "one state": (START[0], 3, 0.1),
    "three axes": (START[None], 3, 0.1),
    "list": (START.tolist(), 3, 0.1),
    "swapped": (START, 0.1, 3),
    "negative": (START, -1, 0.1),
    "lengths of members": (START, 3, torch.full((3,), 0.1)),
    "lengths of a column": (START, 3, torch.full((3, 1), 0.1)),
}


@pytest.mark.parametrize("wrong", PATHS)
def test_a_rollout_of_another_shape_is_refused(wrong):
    with pytest.raises(UserError, match=r"rollout: expected states \(B, D\), a number of steps.*; received "):
        ahnn.NeuralODE(2, 8).double().rollout(*PATHS[wrong])


class Shear(ahnn.dynamics.Dynamics):
    """A map of another package, which has one step and does not check it."""

    assumes = "a shear"
    own_step = 0.1

    def fit(self, statistics):
        """Set nothing."""

    def increment(self, x, dt):
        """Return the same for every step."""
        del dt
        return torch.cat((torch.zeros_like(x[:, :1]), 0.1 * x[:, :1]), -1)


@pytest.mark.parametrize("dt", [0.05, torch.tensor([0.1, 0.05])])
def test_a_map_of_another_package_takes_its_own_step_alone(dt):
    x = torch.ones(2, 2)
    assert torch.equal(Shear()(x, 0.1), torch.tensor([[1.0, 1.1]] * 2))
    with pytest.raises(UserError, match=r"expected the step used in training, 0\.1; received"):
        Shear()(x, dt)


SPACE = ahnn.Space("particle", ("q", "p"), inertia=2.0)
UNSAVED = {
    "module": (lambda to: ahnn.save(torch.nn.Linear(2, 2), SPACE, 0.1, to), "dynamics: expected .* Linear"),
    "space": (lambda to: ahnn.save(free(), ("q", "p"), 0.1, to), "space: expected ahnn.Space"),
    "components": (
        lambda to: ahnn.save(free(), SPACE._replace(components=(*"abcd",)), 0.1, to),
        "components: expected 2",
    ),
    "inertia": (lambda to: ahnn.save(free(1.0), SPACE, 0.1, to), "inertia: expected 2.0"),
    "step": (lambda to: ahnn.save(free(), SPACE, 0, to), "dt: expected float > 0; received 0"),
    "data": (lambda to: ahnn.save(free(), SPACE, 0.1, to, START), "trajectories: expected"),
    "weights": (
        lambda to: ahnn.save(free().requires_grad_(False).apply(lost), SPACE, 0.1, to),
        "expected finite weights",
    ),
}


def lost(module):
    for parameter in module.parameters(recurse=False):
        parameter.fill_(torch.nan)


@pytest.mark.parametrize("wrong", UNSAVED)
def test_what_is_no_run_is_not_saved(tmp_path, wrong):
    call_it, message = UNSAVED[wrong]
    with pytest.raises(UserError, match=message):
        call_it(tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_folder_with_content_is_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UserError, match="folder: expected a new folder"):
        ahnn.save(free(), SPACE, 0.1, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_no_training_takes_over_the_folder_of_a_saved_model(tmp_path):
    ahnn.save(free(), SPACE, 0.1, tmp_path / "mine")
    saved = {path.name: path.read_bytes() for path in (tmp_path / "mine").iterdir()}
    small = ["budget=smoke", "plugins=none", "evaluation=scores"]
    with pytest.raises(UserError, match="expected a folder without weights; received one with weights"):
        ahnn.fit(oscillators(), SPACE, small, folder=tmp_path / "mine")
    assert {path.name: path.read_bytes() for path in (tmp_path / "mine").iterdir()} == saved
