"""The energy of a system and its equations of motion belong together, or the system is refused."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from helpers import SYSTEMS, close

from ahnn.data import Simulated
from ahnn.data.generate import generate
from ahnn.errors import UserError
from ahnn.systems import FilterNoise, MassSpring, System, Units
from ahnn.systems.hamilton_check import energy_gradient, require_hamilton


@dataclass(frozen=True, kw_only=True)
class Stiffer(MassSpring):
    """A spring whose force is too large by a part."""

    excess: float = 0.0

    def force(self, q):
        return (1 + self.excess) * super().force(q)


@dataclass(frozen=True, kw_only=True)
class Faster(MassSpring):
    """A spring whose velocity is twice p / m."""

    def velocity(self, p):
        return 2 * super().velocity(p)


SMALL = {"name": "own", "dt": 0.05, "steps": 20}


@pytest.mark.parametrize("name", SYSTEMS)
def test_systems_of_the_package_agree_with_their_energy(name):
    system = SYSTEMS[name]
    x = system.initial_states(30, torch.Generator().manual_seed(1))
    x = x + 0.01 * x.abs().mean(0) * torch.randn(x.shape, generator=torch.Generator().manual_seed(2)).double()
    require_hamilton(system, x)


def test_differences_are_the_gradient():
    system = MassSpring(**SMALL)
    x = torch.tensor([[0.3, -0.2], [-1.0, 0.5]], dtype=torch.float64)
    exact = torch.cat((-system.force(x[:, :1]), system.velocity(x[:, 1:])), dim=-1)
    close(energy_gradient(system, x), exact, 1e-8)


@pytest.mark.parametrize(
    ("system", "law"), [(Stiffer(**SMALL, excess=0.01), "dp/dt"), (Faster(**SMALL), "dq/dt")]
)
def test_another_force_or_velocity_is_refused(system, law):
    with pytest.raises(UserError, match=rf"system own: expected {law} = .* where the energy gives"):
        generate(system, 4, 0)


FLAT = {
    "force": lambda _, q: -q[..., 0],
    "velocity": lambda _, p: p[..., 0],
    "energy": lambda _, x: x.square() / 2,
    "hamiltonian": lambda _, x: x[..., :1],
    "initial_states": lambda _, count, generator: torch.rand(2, count, generator=generator).double(),
}


@pytest.mark.parametrize("method", FLAT)
def test_a_method_that_returns_another_shape_is_named(method):
    system = type("Flat", (MassSpring,), {method: FLAT[method]})(**SMALL)
    with pytest.raises(
        UserError, match=rf"system own: expected a tensor of shape .* from `{method}`; received"
    ):
        generate(system, 4, 0)
    with pytest.raises(UserError, match=f"from `{method}`"):
        Simulated(system, trajectories=4, seed=0, cache="none").steps()


def test_initial_states_in_single_precision_are_refused():
    draw = lambda _, count, generator: torch.rand(count, 2, generator=generator)  # noqa: E731
    system = type("Single", (MassSpring,), {"initial_states": draw})(**SMALL)
    with pytest.raises(UserError, match=r"`initial_states`; received float32\. Give dtype=torch\.float64"):
        generate(system, 4, 0)


def test_what_rounding_explains_is_not_refused():
    generate(Stiffer(**SMALL, excess=1e-6), 4, 0)


@dataclass(frozen=True, kw_only=True)
class Forceless(System):
    """H = p^2 (1 + q^2) / 2, of which no force is defined."""

    dof = 1
    components = ("q", "p")
    units = Units()
    integrator = "dopri8"
    noise = FilterNoise(1e-3, 1e-3, 1e-3)

    def energy(self, x):
        q, p = x.unbind(-1)
        return p**2 * (1 + q**2) / 2

    def initial_states(self, count, generator):
        return 0.5 + torch.rand(count, 2, generator=generator, dtype=torch.float64)


@dataclass(frozen=True, kw_only=True)
class General(Forceless):
    """The same with its field."""

    separable = False

    def hamiltonian(self, x):
        q, p = x.unbind(-1)
        return torch.stack((p * (1 + q**2), -(p**2) * q), dim=-1)


def test_a_general_hamiltonian_needs_no_force():
    system = General(**SMALL)
    x = generate(system, 30, 0).states
    close(system.energy(x), system.energy(x[:, :1]).expand(x.shape[:-1]), 1e-9)
    weak, _, strong = system.phases(x).values()
    rates = (x[..., 1] ** 2 * x[..., 0]).abs()
    assert rates[weak].max() < rates[strong].min()
    with pytest.raises(UserError, match=r"system own: expected the method `force`; received none\. Define"):
        generate(Forceless(**SMALL), 4, 0)


@dataclass(frozen=True, kw_only=True)
class Exponential(MassSpring):
    """H = e^p - p + e^q - q, with differences at rest that are rounding errors, but not 0."""

    def energy(self, x):
        return (x.exp() - x).sum(-1)

    def velocity(self, p):
        return p.exp() - 1

    def force(self, q):
        return 1 - q.exp()


def test_at_rest_rounding_errors_are_no_other_energy():
    system = Exponential(**SMALL)
    x = torch.stack((torch.linspace(-1, 1, 100).double(), torch.zeros(100).double()), -1)
    assert bool(energy_gradient(system, x)[:, 1].abs().max() > 0)
    require_hamilton(system, x)
    object.__setattr__(system, "velocity", lambda p: p.exp() - 1 + 1e-8)
    with pytest.raises(UserError, match="dq/dt = dH/dp"):
        require_hamilton(system, x)
