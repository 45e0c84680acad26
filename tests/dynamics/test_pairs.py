"""Pair potentials: forces are slopes of the energy, symmetric, for any number of bodies."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator

import ahnn
from ahnn.data.generate import generate
from ahnn.dynamics import make_dynamics
from ahnn.dynamics.derivatives import field_jacobian, mapped_field_jacobian
from ahnn.dynamics.fields import HamiltonianDynamics
from ahnn.dynamics.pair_potential import for_bodies
from ahnn.errors import UserError
from ahnn.statistics import Statistics
from ahnn.systems import NBody

THREE = NBody(name="three", dt=0.01, steps=20, masses=[1.0, 2.0, 0.5])


def given(system):
    options = {"hamiltonian": "pairs", "mu": None, "falloff": 1.0, "dimensions": 2, "inputs": "cartesian"}
    options |= {"network": {"width": 6, "depth": 2, "activation": "tanh"}, "integrator": {"name": "rk4"}}
    return options | {"dof": system.dof, "inertia": list(system.inertia), "scaling": "minmax"}


def dynamics(system=THREE, **options):
    torch.manual_seed(0)
    found = HamiltonianDynamics(**given(system) | options).double()
    found.fit(Statistics.of(generate(system, 8, 0)))
    return found


def states(count=9):
    x = generate(THREE, count, 1).states[:, 10]
    return x + 0.1 * torch.randn(x.shape, dtype=torch.float64, generator=generator(2))


def moved(x, change):
    """States with their positions changed, (count, bodies, 2) -> the same."""
    q, p = x.chunk(2, dim=-1)
    return torch.cat((change(q.unflatten(-1, (3, 2))).flatten(-2), p), dim=-1)


@pytest.mark.parametrize("falloff", [0.0, 1.0, 3.0])
def test_the_field_is_that_of_the_energy(falloff):
    found, x = dynamics(falloff=falloff), states().requires_grad_()
    (slope,) = torch.autograd.grad(found.energy(x).sum(), x)
    dq, dp = slope.chunk(2, dim=-1)
    close(found.field(x), torch.cat((dp, -dq), dim=-1), 1e-12)


@pytest.mark.parametrize("falloff", [0.0, 1.0])
def test_derivatives_by_parameters_are_those_of_reverse_mode(falloff):
    found, x = dynamics(falloff=falloff), states()
    theta = torch.nn.utils.parameters_to_vector(found.parameters()).detach()
    by = torch.randn(x.shape, dtype=torch.float64, generator=generator(3))
    assert found.field.has_rows
    ours, theirs = (
        make(found, torch.float64)(theta, x, by) for make in (field_jacobian, mapped_field_jacobian)
    )
    close(ours, theirs, 1e-11)


def test_forces_of_pairs_are_opposite_and_follow_turns_and_shifts():
    found, x = dynamics(), states()
    force = found.field(x)[:, 6:].unflatten(-1, (3, 2)).detach()
    assert float(force.sum(1).abs().max()) < 1e-12 * float(force.abs().max())
    shift = torch.tensor([3.0, -7.0], dtype=torch.float64)
    close(found.field(moved(x, lambda q: q + shift))[:, 6:], found.field(x)[:, 6:], 1e-9)
    turn = torch.tensor([[0.6, -0.8], [0.8, 0.6]], dtype=torch.float64)
    close(found.field(moved(x, lambda q: q @ turn.T))[:, 6:].unflatten(-1, (3, 2)), force @ turn.T, 1e-9)


def test_bodies_of_one_mass_may_change_places():
    found = for_bodies(dynamics(), [1.5, 1.5, 0.5])
    x = states()
    swapped = moved(x, lambda q: q[:, [1, 0, 2]])
    force, other = (found.field(y)[:, 6:].unflatten(-1, (3, 2)) for y in (x, swapped))
    close(other[:, [1, 0, 2]], force, 1e-12)


def test_what_was_learned_of_three_bodies_adds_up_for_five():
    """The energy of five bodies is that of their pairs, each by itself."""
    learned, masses = dynamics(), [1.0, 2.0, 0.5, 3.0, 0.25]
    five = for_bodies(learned, masses)
    q = 2 * torch.randn(4, 5, 2, dtype=torch.float64, generator=generator(4))
    x = torch.cat((q.flatten(1), torch.zeros(4, 10, dtype=torch.float64)), dim=-1)
    pairs = 0.0
    for i in range(5):
        for j in range(i):
            two = for_bodies(learned, [masses[i], masses[j]])
            pairs = pairs + two.energy(torch.cat((q[:, i], q[:, j], torch.zeros(4, 4).double()), dim=-1))
    close(five.energy(x), pairs, 1e-12)


@pytest.mark.parametrize("masses", [[1.0, 2.0, 0.5, 1.5, 0.8], [3.0, 1.0], [1.0, 1.0, 1.0]])
def test_the_dynamics_of_other_bodies_propagate_their_states_and_are_saved(tmp_path, masses):
    learned = make_dynamics("hamiltonian", **given(THREE)).double()
    learned.fit(Statistics.of(generate(THREE, 8, 0)))
    found, dof = for_bodies(learned, masses), 2 * len(masses)
    x = torch.cat((3 * torch.randn(4, dof, generator=generator(5)), torch.zeros(4, dof)), dim=-1).double()
    step = found(x, 0.01)
    close(step, x + found.increment(x, 0.01), 1e-12)
    orbit = found.rollout(x, 5, 0.01)
    assert orbit.shape == (4, 6, 2 * dof)
    close(orbit[:, 1], step, 1e-12)
    close(found.energy(orbit[:, -1]), found.energy(x), 1e-3)
    each = [mass for mass in masses for _ in range(2)]
    assert f"dof={dof}, inertia={each}" in repr(found)
    assert learned.spec["dof"] == 6
    names = tuple(f"{kind}{k}" for kind in ("q", "p") for k in range(dof))
    run = ahnn.save(found, ahnn.Space("bodies", names, inertia=tuple(each)), 0.01, tmp_path / "run")
    close(run.rollout(x, 5), orbit, 1e-12)
    close(ahnn.load(tmp_path / "run").energy(x), found.energy(x), 1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dimensions": 4}, "pairs: expected 4 coordinates for each of two or more bodies; received 6"),
        ({"dimensions": 3}, "pairs: expected one mass for all coordinates of a body"),
        ({"dimensions": None}, "dimensions: expected coordinates of a body; received None"),
        (
            {"hamiltonian": "generic", "falloff": 0.0},
            "dimensions: expected None, since generic has no bodies",
        ),
    ],
)
def test_coordinates_that_are_not_those_of_bodies_are_refused(options, message):
    with pytest.raises(UserError, match=message):
        dynamics(**options)


def test_other_dynamics_and_masses_are_refused():
    with pytest.raises(UserError, match="for_bodies: expected dynamics with hamiltonian=pairs"):
        for_bodies(dynamics(hamiltonian="generic", dimensions=None, falloff=0.0), [1.0, 1.0])
    with pytest.raises(UserError, match="masses: expected two or more finite masses > 0"):
        for_bodies(dynamics(), [1.0])
    with pytest.raises(UserError, match="masses: expected numbers"):
        for_bodies(dynamics(), ["a", "b"])  # pyright: ignore[reportArgumentType]


def test_its_network_sees_distances_from_the_least_to_the_largest():
    """Their logarithms, those of the training between -1 and 1."""
    found = dynamics()
    q = generate(THREE, 8, 0).states[..., :6].flatten(0, 1).unflatten(-1, (3, 2))
    logs = torch.stack([(q[:, i] - q[:, j]).norm(dim=-1).log() for i, j in ((0, 1), (0, 2), (1, 2))], -1)
    seen = found.field.potential.seen(q.flatten(-2))
    close(seen.diff(dim=-1).clamp(max=0.0), torch.zeros(len(q), 2), 1e-12)
    logs = logs.sort(-1).values
    slope = (seen[-1, 2] - seen[-1, 0]) / (logs[-1, 2] - logs[-1, 0])
    close(seen - seen[-1, 0], slope * (logs - logs[-1, 0]), 1e-9)
    assert -1.5 < float(seen.detach().min()) < -0.9
    assert 0.9 < float(seen.detach().max()) < 1.5
