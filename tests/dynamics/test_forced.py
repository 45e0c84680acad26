"""Forces beside a Hamiltonian: power balance, closed forms, extended states and their derivatives."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from torch.func import jacrev, vmap
from torch.nn.utils import parameters_to_vector

from ahnn.clock import Clock, extended, on_clock, reduced
from ahnn.dynamics import make_dynamics
from ahnn.dynamics.derivatives import field_jacobian, parametrised
from ahnn.dynamics.forces import Instant, make_force
from ahnn.dynamics.variations import jacobians_of_steps, mapped_jacobians_of_steps
from ahnn.errors import UserError
from ahnn.integrators import INTEGRATORS
from ahnn.rollouts import rollout
from ahnn.systems import Molniya

DOUBLE = {"dtype": torch.float64}
FRICTION = {"kind": "friction", "of": "positions"}
CONTROLS = {"kind": "actuation", "of": "positions"}


def dynamics(forces, dof=2, controls=0, hamiltonian="generic", integrator="rk4"):
    torch.manual_seed(3)
    made = make_dynamics(
        "hamiltonian",
        dof=dof,
        inertia=1.5,
        hamiltonian=hamiltonian,
        mu=None,
        inputs="cartesian",
        scaling="none",
        network={"width": 12, "depth": 2, "activation": "tanh"},
        integrator={"name": integrator},
        forces=forces,
        controls=controls,
    ).double()
    for parameter in made.parameters():
        parameter.data += 0.3 * torch.randn(parameter.shape, generator=generator(4), **DOUBLE)
    return made


def states(count, size, seed=0):
    return torch.randn(count, size, generator=generator(seed), **DOUBLE)


@pytest.mark.parametrize("hamiltonian", ["generic", "mechanical"])
@pytest.mark.parametrize("of", ["positions", "matrix", "constant"])
def test_the_energy_changes_by_the_power_of_friction_and_controls_alone(hamiltonian, of):
    """dH/dt = -v^T R v + v^T G u, by the chain rule along the field."""
    given = {"friction": {**FRICTION, "of": of}, "controls": CONTROLS}
    model = dynamics(given, controls=3, hamiltonian=hamiltonian)
    x, u = states(50, 4), states(50, 3, 1)
    clock = Clock(torch.cat((torch.zeros(50, 1, **DOUBLE), u), 1), torch.zeros(50, 4, **DOUBLE))
    z = extended(x, clock)
    rate = reduced(model.field(z), model.clock)
    (slope,) = torch.autograd.grad(model.energy(x.requires_grad_()).sum(), x)
    power = (slope * rate).sum(-1)
    friction, controls = model.field.forces["friction"], model.field.forces["controls"]
    q, v = x[:, :2].detach(), rate[:, :2]
    spent = torch.einsum("bi,bij,bj->b", v, friction.matrix(q), v)
    supplied = torch.einsum("bi,bij,bj->b", v, controls.matrix(q), u)
    close(power, supplied - spent, 1e-12)
    assert bool((spent >= 0).all())
    assert float(spent.detach().max()) > 1e-3
    eigenvalues = torch.linalg.eigvalsh(friction.matrix(q))
    assert bool((eigenvalues >= -1e-12).all())


def test_a_damped_and_forced_spring_is_its_closed_form():
    """M x'' + r x' + k x = b sin(w t): the steady state is of amplitude b / |k - m w^2 + i r w|."""
    m, k, r, b, w = 1.5, 5.0, 0.4, 0.7, 1.3
    forces = {
        "friction": {"coefficient": r},
        "spring": {"stiffness": k},
        "forcing": {"frequency": w, "sine": [b]},
    }
    model = dynamics(forces, dof=1, hamiltonian="mechanical", integrator="dopri8")
    for parameter in model.field.hamiltonian.parameters():
        parameter.data.zero_()
    gain = b / complex(k - m * w * w, r * w)
    times = torch.linspace(0, 20, 401, **DOUBLE)
    exact = gain * torch.exp(1j * w * times)
    start = torch.tensor([[gain.imag, m * (1j * w * gain).imag]], **DOUBLE)
    found = rollout(model, start, 0.05, 401, clock=Clock.of(times, None))
    close(found[0, :, 0], exact.imag, 1e-9)
    close(found[0, :, 1], m * (1j * w * exact).imag, 1e-9)


def test_held_controls_jump_and_linear_ones_do_not():
    """A free mass under a control: p is the integral of u, exactly, for steps and for a polygon."""
    model = dynamics({"controls": {"kind": "actuation", "matrix": [[1.0]]}}, 1, 1, "mechanical", "rk4")
    for parameter in model.parameters():
        parameter.data.zero_()
    times, u = torch.arange(5.0, **DOUBLE) / 2, torch.tensor([1.0, -2.0, 0.5, 3.0, 7.0], **DOUBLE)
    start = torch.zeros(1, 2, **DOUBLE)
    held = rollout(model, start, 0.5, 5, clock=Clock.of(times, u[:, None]))
    close(held[0, :, 1], torch.tensor([0.0, 0.5, -0.5, -0.25, 1.25], **DOUBLE), 1e-14)
    ramps = rollout(model, start, 0.5, 5, clock=Clock.of(times, u[:, None], linear=True))
    mean = (u[1:] + u[:-1]) / 4
    close(ramps[0, 1:, 1], mean.cumsum(0), 1e-14)


@torch.no_grad()
@pytest.mark.parametrize("name", ["rk4", "dopri8", "gl4"])
@pytest.mark.sampled(3)
def test_methods_keep_their_order_under_forces_that_depend_on_time(name):
    model = dynamics({"forcing": {"frequency": 2.0}, "friction": {}}, integrator=name)
    start, exact = states(4, 4), INTEGRATORS["dopri8"]
    clock = Clock(torch.zeros(4, 1, **DOUBLE), torch.ones(4, 1, **DOUBLE))

    def end(method, steps):
        z = extended(start, clock)
        for _ in range(steps):
            z = method.step(model.field, z, 1.0 / steps)
        return reduced(z, 1)

    truth, counts = end(exact, 400), (4, 8) if name == "dopri8" else (16, 32)
    coarse, fine = ((end(INTEGRATORS[name], n) - truth).norm() for n in counts)
    order = INTEGRATORS[name].order
    assert order - 0.5 < float((coarse / fine).log2()) < order + 1.5


def test_known_attractions_are_those_of_the_molniya_system():
    system = Molniya(name="m", dt=60.0, steps=10)
    x = system.initial_states(30, generator(0)) + states(30, 6) * torch.tensor(
        [500.0] * 3 + [0.1] * 3, **DOUBLE
    )
    q, nothing = x[:, :3], x[:, :0]
    at = Instant(nothing, nothing, q, x[:, 3:])
    options = {"mu": system.mu, "mass": system.mass}
    parts = [
        make_force("central_attraction", 3, 0, options),
        make_force("oblateness", 3, 0, {**options, "radius": system.r_eq, "j2": system.j2}),
    ]
    close(sum(part(at) for part in parts), system.force(q), 1e-12)
    kinetic = x[:, 3:].square().sum(-1) / 2
    close(sum(part.potential(at) for part in parts) + kinetic, system.energy(x), 1e-12)


@pytest.mark.parametrize("hamiltonian", ["generic", "mechanical"])
def test_rows_of_the_field_are_its_derivatives(hamiltonian):
    forces = {"friction": {}, "controls": {"kind": "actuation"}, "network": {"sees": ["q", "v", "t"]}}
    model = dynamics(forces, controls=2, hamiltonian=hamiltonian)
    z = states(7, 2 * (2 + 3))
    theta = parameters_to_vector(model.parameters()).detach()
    function = parametrised(model, model.field, torch.float64)
    expected = vmap(jacrev(lambda t, x: function(t, x[None])[0]), (None, 0))(theta, z)
    rows = field_jacobian(model, torch.float64)(theta, z)
    close(rows, expected[:, -rows.shape[1] :], 1e-9)
    assert float(expected[:, : -rows.shape[1]].abs().sum()) == 0
    factors = states(7, z.shape[1], 5)
    scaled = field_jacobian(model, torch.float64)(theta, z, factors)
    close(scaled, rows * factors[:, -rows.shape[1] :, None], 1e-12)


def test_a_clock_is_reset_where_it_is_known():
    x, clock = states(3, 4), Clock(states(3, 3, 1), states(3, 3, 2))
    z, known = extended(x, clock), states(3, 10, 3)
    assert torch.equal(reduced(z, 3), x)
    moved = on_clock(z, known, 3)
    assert torch.equal(reduced(moved, 3), x)
    assert torch.equal(moved[:, 2:5], known[:, 2:5])
    assert torch.equal(moved[:, 7:], known[:, 7:])
    assert on_clock(z, known, 1) is z


def test_what_makes_no_force_is_a_message():
    with pytest.raises(UserError, match=r"forces\.drag: expected kind, one of friction.*received 'drag'"):
        make_force("drag", 2, 0, {})
    with pytest.raises(UserError, match="controls: expected data with controls"):
        make_force("controls", 2, 0, {"kind": "actuation"})
    with pytest.raises(UserError, match="coefficient: expected a list of float >= 0"):
        make_force("friction", 2, 0, {"coefficient": [1.0, -1.0]})
    with pytest.raises(UserError, match="expected 2 rows of 1 numbers"):
        make_force("a", 2, 1, {"kind": "actuation", "matrix": [[1.0]]})
    with pytest.raises(UserError, match="symmetric matrix, 2 by 2"):
        make_force("spring", 2, 0, {"stiffness": [[1.0, 2.0], [0.0, 1.0]]})
    with pytest.raises(UserError, match="rollout: expected the times of the samples"):
        rollout(dynamics({"forcing": {"frequency": 1.0}}), states(1, 4), 0.1, 3)


@pytest.mark.parametrize("hamiltonian", ["generic", "mechanical"])
def test_jacobians_of_steps_in_closed_form_are_those_of_reverse_mode(hamiltonian):
    forces = {"friction": FRICTION, "controls": {"kind": "actuation"}, "network": {"sees": ["q", "v", "t"]}}
    model = dynamics(forces, controls=1, hamiltonian=hamiltonian)
    theta = parameters_to_vector(model.parameters()).detach()
    z, lengths = states(3, 2 * 8 * 4).view(3, 8, 8), 0.1 + 0.01 * torch.rand(3, 8, **DOUBLE)
    own = jacobians_of_steps(model, torch.float64)(theta, z, lengths)
    close(own, mapped_jacobians_of_steps(model, torch.float64)(theta, z, lengths), 1e-11)


@pytest.mark.parametrize(
    "options",
    [
        {"kind": "friction"},
        {"kind": "friction", "of": "positions"},
        {"kind": "friction", "of": "matrix"},
        {"kind": "actuation"},
        {"kind": "actuation", "of": "positions"},
        {"kind": "actuation", "matrix": [[1.0, 0.0, -2.0]] * 3},
        {"kind": "forcing", "frequency": 2.0, "cosine": [1.0, 2.0, -1.0], "sine": [0.5, 0.0, 1.0]},
        {"kind": "spring", "stiffness": [[2.0, 1.0, 0.0], [1.0, 3.0, 0.5], [0.0, 0.5, 1.0]]},
        {"kind": "central_attraction", "mu": 1.7},
        {"kind": "oblateness", "mu": 1.7, "radius": 0.5, "j2": 0.1},
        {"kind": "network", "sees": ["q", "v", "t", "u"]},
        {"kind": "orbital", "mu": 1.7, "radius": 0.5, "degree": 3},
        {"kind": "elliptic_equator", "mu": 1.7, "radius": 0.5, "angle": 0.4, "rate": 0.7},
    ],
    ids=lambda options: "-".join(map(str, options.values()))[:24],
)
def test_a_force_changes_with_its_arguments_as_central_differences_say(options):
    force = make_force("own", 3, 3, options).double()
    for parameter in force.parameters():
        parameter.data += 0.5 * torch.randn(parameter.shape, generator=generator(5), **DOUBLE)
    at = Instant(*(states(6, size, size + k) for k, size in enumerate((1, 3, 3, 3))))
    by = Instant(*(torch.randn(6, 4, p.shape[1], generator=generator(k), **DOUBLE) for k, p in enumerate(at)))

    def moved(step):
        return force(Instant(*(a.unsqueeze(1) + step * b for a, b in zip(at, by, strict=True))))

    close(force.variation(at, by).detach(), (moved(1e-5) - moved(-1e-5)).detach() / 2e-5, 1e-7)


def test_a_friction_matrix_tells_its_lower_triangle_and_takes_no_coefficient():
    force = make_force("own", 2, 0, {"kind": "friction", "of": "matrix"}).double()
    force.lower.data = torch.tensor([1.0, -0.5, 2.0], **DOUBLE)
    whole = torch.tensor([[1.0, -0.5], [-0.5, 4.25]], **DOUBLE)
    close(force.matrix(torch.zeros(2, **DOUBLE)).detach(), whole, 1e-15)
    close(force.constants()["matrix"].detach(), torch.tensor([1.0, -0.5, 4.25], **DOUBLE), 1e-15)
    with pytest.raises(UserError, match="expected no coefficient with of=matrix"):
        make_force("own", 2, 0, {"kind": "friction", "of": "matrix", "coefficient": 0.1})


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"kind": "actuation", "matrix": [[float("nan")], [1.0]]}, "matrix: expected"),
        ({"kind": ["actuation"]}, "expected kind, one of"),
        ({"kind": "actuation", "matrix": [[1.0], [1.0]], "of": "positions"}, "no matrix with of=positions"),
        ({"kind": "friction", "coefficient": [0.1, float("nan")]}, "coefficient: expected"),
        ({"kind": "friction", "coefficient": [0.1, -0.1]}, "coefficient: expected"),
        ({"kind": "forcing", "frequency": 1.0, "sine": [float("inf"), 1.0]}, "sine: expected"),
        ({"kind": "spring", "stiffness": [[float("inf"), 0.0], [0.0, 1.0]]}, "stiffness: expected"),
    ],
    ids=lambda given: str(given["kind"]) if isinstance(given, dict) else "",
)
def test_numbers_of_forces_that_are_none_are_refused(options, said):
    with pytest.raises(UserError, match=said):
        make_force("own", 2, 1, options)
