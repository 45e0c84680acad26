"""The energy of a system and its equations of motion belong together, or the system is refused."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from helpers import SYSTEMS, close

from ahnn.data.generate import generate
from ahnn.errors import UserError
from ahnn.systems import MassSpring
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


def test_what_rounding_explains_is_not_refused():
    generate(Stiffer(**SMALL, excess=1e-6), 4, 0)
