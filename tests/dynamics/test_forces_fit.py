"""Units and first guesses that forces take from the training split."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator

from ahnn.dynamics import make_dynamics
from ahnn.dynamics.forces import Instant, make_force
from ahnn.statistics import Statistics

DOUBLE = {"dtype": torch.float64}
RATE = torch.tensor([2.0, 4.0, 6.0, 20.0], **DOUBLE)  # of q, then of p: 3 and 5 of momenta over velocities


def statistics(**changes):
    """Of random examples with one control and the time."""
    drawn = [torch.randn(50, 2, generator=generator(k), **DOUBLE) for k in range(4)]
    largest = torch.full((4,), 3.0, **DOUBLE)
    made = Statistics(-largest, 2 * largest, 0.1 * RATE, RATE, torch.tensor([0.1, 5.0]), *drawn, 0.1)
    return made._replace(**changes)


def fitted(options, controls=0, of=None):
    torch.manual_seed(0)
    force = make_force("own", 2, controls, options).double()
    force.fit(of or statistics())
    return force


def instants(count=7):
    return Instant(*(torch.randn(count, n, generator=generator(9 + n), **DOUBLE) for n in (1, 1, 2, 2)))


def test_a_learned_friction_begins_at_a_hundredth_of_force_over_velocity():
    q, expected = instants().q, torch.tensor([0.03, 0.05], **DOUBLE)
    close(fitted({"kind": "friction"}).coefficients(), expected, 1e-6)
    close(fitted({"kind": "friction"}).constants()["coefficient"], expected, 1e-6)
    close(fitted({"kind": "friction", "of": "matrix"}).matrix(q), expected.diag().expand(7, 2, 2), 1e-6)
    close(fitted({"kind": "friction", "coefficient": [1.0, 0.0]}).coefficients(), torch.tensor([1.0, 0.0]), 0)
    assert fitted({"kind": "friction", "coefficient": 1.0}).constants() == {}


def test_a_friction_of_positions_is_in_units_of_force_over_velocity():
    """The network sees positions between -1 and 1, and its output counts in these units."""
    force = fitted({"kind": "friction", "of": "positions"})
    q = instants().q
    entries = force.network((q - 1.5) / 4.5)
    lower = torch.zeros(7, 2, 2, **DOUBLE)
    lower[:, 0, 0], lower[:, 1, 0], lower[:, 1, 1] = entries.unbind(-1)
    close(force.matrix(q), 4.0 * lower @ lower.mT, 1e-6)
    assert force.constants() == {}


def test_controls_of_typical_size_push_as_much_as_the_typical_force():
    clock = torch.tensor([[0.0, 3.0], [1.0, -3.0], [2.0, 3.0]], **DOUBLE)
    force = fitted({"kind": "actuation"}, 1, statistics(clock=clock))
    assert not bool(force.matrix(instants().q).any())
    force.weight.data = torch.tensor([[1.0], [-0.5]], **DOUBLE)
    expected = 13.0 / 3.0 * force.weight
    close(force.matrix(instants().q), expected.expand(7, 2, 1), 1e-6)
    close(force.constants()["matrix"], expected, 1e-6)
    close(force(Instant(clock[:, :1], clock[:, 1:], clock, clock)), clock[:, 1:] @ expected.T, 1e-6)
    learned = fitted({"kind": "actuation", "of": "positions"}, 1, statistics(clock=clock))
    seen = learned.network((instants().q - 1.5) / 4.5)
    close(learned.matrix(instants().q), 13.0 / 3.0 * seen.unsqueeze(-1), 1e-6)
    assert learned.constants() == {}
    still = fitted({"kind": "actuation"}, 1, statistics(clock=0 * clock))
    assert bool(still.unit.isfinite().all())
    known = fitted({"kind": "actuation", "matrix": [[1.0], [2.0]]}, 1)
    assert known.constants() == {}
    close(known.unit, torch.ones(1), 0)


def test_learned_amplitudes_are_in_units_of_the_typical_force():
    force = fitted({"kind": "forcing", "frequency": 2.0})
    force.amplitudes.data = torch.tensor([[1.0, 0.0], [0.5, -1.0]], **DOUBLE)
    at = instants()
    a, b = torch.tensor([[6.0, 0.0], [3.0, -20.0]], **DOUBLE)
    close(force(at), a * (2 * at.t).cos() + b * (2 * at.t).sin(), 1e-6)
    assert {k: v.tolist() for k, v in force.constants().items()} == {"cosine": [6, 0], "sine": [3, -20]}
    assert fitted({"kind": "forcing", "frequency": 2.0, "sine": [1.0, 2.0]}).constants() == {}


@pytest.mark.parametrize("sees", [["q"], ["v", "t"], ["u", "q"], ["q", "v", "t", "u"]])
def test_a_network_sees_the_examples_between_minus_one_and_one(sees):
    """In the order t, u, q, v, and its output counts in root mean squares of the forces."""
    of = statistics()
    force, seen = fitted({"kind": "network", "sees": sees}, 1, of), []
    force.network.register_forward_pre_hook(lambda _, given: seen.append(given[0]))
    parts = {"t": of.clock[:, :1], "u": of.clock[:, 1:], "q": of.positions, "v": of.velocities}
    found = force(Instant(*parts.values()))
    close(seen[0].amin(0), -torch.ones(seen[0].shape[1]), 1e-6)
    close(seen[0].amax(0), torch.ones(seen[0].shape[1]), 1e-6)
    given = torch.cat([parts[name] for name in "tuqv" if name in sees], -1)
    order = given.argsort(0)
    assert torch.equal(seen[0].argsort(0), order)
    close(found, of.forces.square().mean(0).sqrt() * force.network(seen[0]), 1e-6)
    assert (force.timed, force.controlled) == ("t" in sees, "u" in sees)


def test_a_force_with_a_potential_is_its_slope():
    at = instants()
    for options in (
        {"kind": "spring", "stiffness": [[2.0, 1.0], [1.0, 3.0]]},
        {"kind": "spring", "stiffness": 2.5},
        {"kind": "central_attraction", "mu": 1.7, "mass": 2.0},
    ):
        force, q = make_force("own", 2, 0, options), at.q.clone().requires_grad_()
        (slope,) = torch.autograd.grad(force.potential(at._replace(q=q)).sum(), q)
        close(force(at), -slope, 1e-12)


def test_hamiltonian_and_learned_forces_are_fitted_to_what_known_forces_leave():
    """Of forces three times as large as a known one, one of q alone, two thirds are left."""
    stiffness = [[2.0, 1.0], [1.0, 3.0]]
    drawn = statistics()
    known = -drawn.positions @ torch.tensor(stiffness, **DOUBLE)
    of = drawn._replace(forces=3 * known)
    left = of.without(known)
    close(left.forces, 2 * known, 1e-12)
    close(left.rate, torch.cat((RATE[:2], 2 / 3 * RATE[2:])), 1e-12)
    made = make_dynamics(
        "hamiltonian",
        dof=2,
        inertia=1.0,
        hamiltonian="mechanical",
        mu=None,
        inputs="cartesian",
        scaling="none",
        network={"width": 4, "depth": 1, "activation": "tanh"},
        integrator={"name": "rk4"},
        forces={"spring": {"stiffness": stiffness}, "friction": {}},
        controls=1,
    ).double()
    fitted_to = []
    made.field.hamiltonian.fit = fitted_to.append
    made.field.fit(of)
    close(fitted_to[0].forces, 2 * known, 1e-12)
    close(made.field.forces["friction"].coefficients(), torch.tensor([0.02, 0.1 / 3]), 1e-6)
