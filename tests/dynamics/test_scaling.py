"""Hamilton's equations hold exactly in any scaling: the exact H in scaled coordinates gives the true flow."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from helpers import MOLNIYA, SPRING, TINY, close, data_module, generator, random_states
from torch import nn

from ahnn.dynamics.hamiltonians import make_hamiltonian
from ahnn.dynamics.inputs import Isotropic, position_inputs
from ahnn.dynamics.scaling import Affine
from ahnn.errors import UserError
from ahnn.integrators import INTEGRATORS
from ahnn.statistics import Statistics

SYSTEMS = {"mass_spring": SPRING, "molniya": MOLNIYA, "heavy": dataclasses.replace(MOLNIYA, mass=2.5)}


class Exact(nn.Module):
    """Stands for a network that has learned an energy perfectly, as a function of its own scaled inputs."""

    def __init__(self, energy, unscale, unit):
        super().__init__()
        self.energy, self.unscale, self.unit = energy, unscale, unit

    def forward(self, z):
        return self.energy(self.unscale(z)).unsqueeze(-1) / self.unit

    def gradient(self, z):
        with torch.enable_grad():
            z = z.detach().requires_grad_()
            return torch.autograd.grad(self(z).sum(), z)[0]


def draw(affine, x, rng):
    """Set a random scaling: shifts of the size of the data, scales over two decades for each component."""
    size = x.abs().amax()
    affine.shift.copy_(size * torch.randn(affine.shift.shape, generator=rng, dtype=torch.float64))
    decades = 2 * torch.rand(affine.scale.shape, generator=rng, dtype=torch.float64) - 1
    affine.scale.copy_(size * 10**decades)


def scaled_truth(structure, system, x, seed, inputs="cartesian"):
    """A learned Hamiltonian with random scalings whose networks are replaced by the exact energies."""
    rng = generator(seed)
    options = {"mass": system.inertia, "mu": None, "scaling": "minmax", "network": TINY}
    learned = make_hamiltonian(structure, system.dof, inputs=inputs, **options).double()
    q, p = x.chunk(2, dim=-1)

    def kinetic(p):
        return system.energy(torch.cat((torch.ones_like(p), p), -1)) - system.energy(
            torch.cat((torch.ones_like(p), torch.zeros_like(p)), -1)
        )

    def potential(q):
        return system.energy(torch.cat((q, torch.zeros_like(q)), -1))

    def unscale_positions(inputs):
        if isinstance(inputs, Isotropic):
            inputs.middle.fill_(9.0)
            inputs.spread.fill_(float(0.5 + torch.rand((), generator=rng)))
            return lambda z: z[..., :-1] * (inputs.middle + inputs.spread * z[..., -1:]).exp()
        draw(inputs.affine, q, rng)
        return inputs.affine.inverse

    if structure == "generic":
        positions = unscale_positions(learned.positions)
        draw(learned.momenta.affine, p, rng)
        learned.unit.fill_(float(10 * torch.rand((), generator=rng)))
        split = learned.positions.size

        def unscale(z):
            return torch.cat((positions(z[..., :split]), learned.momenta.affine.inverse(z[..., split:])), -1)

        learned.network = Exact(system.energy, unscale, learned.unit)
        return learned
    parts = [(learned.potential, potential, unscale_positions(learned.potential.inputs))]
    if structure == "separable":
        draw(learned.kinetic.inputs.affine, p, rng)
        parts.append((learned.kinetic, kinetic, learned.kinetic.inputs.affine.inverse))
    for part, energy, unscale in parts:
        part.unit.fill_(float(10 * torch.rand((), generator=rng)))
        part.network = Exact(energy, unscale, part.unit)
    return learned


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("structure", ["generic", "separable", "mechanical"])
@pytest.mark.sampled(4)
def test_the_exact_energy_in_any_of_100_scalings_gives_the_true_flow(structure, name):
    system = SYSTEMS[name]
    start = random_states(system, 4, seed=8)
    truth = start
    for _ in range(3):
        truth = INTEGRATORS["rk4"].step(system, truth, system.dt)
    moved = truth - start
    for seed in range(100):
        learned = scaled_truth(structure, system, start, seed)
        x = start
        for _ in range(3):
            x = INTEGRATORS["rk4"].step(learned, x, system.dt)
        for part, expected in zip((x - start).chunk(2, -1), moved.chunk(2, -1), strict=True):
            close(part, expected, 1e-10)


@pytest.mark.parametrize("structure", ["generic", "separable", "mechanical"])
def test_isotropic_inputs_keep_hamiltons_equations(structure):
    x = random_states(MOLNIYA, 20, seed=9)
    for seed in range(20):
        learned = scaled_truth(structure, MOLNIYA, x, seed, inputs="isotropic")
        for got, expected in zip(learned(x).chunk(2, -1), MOLNIYA(x).chunk(2, -1), strict=True):
            close(got, expected, 1e-10)


def test_the_learned_energy_is_the_true_one_in_any_scaling():
    x = random_states(MOLNIYA, 5, seed=10)
    for structure in ("generic", "separable", "mechanical"):
        close(scaled_truth(structure, MOLNIYA, x, 3).energy(x), MOLNIYA.energy(x), 1e-10)


@pytest.mark.parametrize("kind", ["minmax", "block", "none"])
def test_a_scaling_is_inverted_exactly_and_maps_into_the_unit_cube(kind):
    low = torch.tensor([-3.0, 5.0, 0.0], dtype=torch.float64)
    high = torch.tensor([1.0, 5.5, 10.0], dtype=torch.float64)
    affine = Affine(kind, 3).double()
    affine.fit(low, high)
    x = low + (high - low) * torch.rand(50, 3, generator=generator(0), dtype=torch.float64)
    close(affine.inverse(affine(x)), x, 1e-15)
    corners = affine(torch.stack((low, high)))
    if kind == "minmax":
        close(corners, torch.tensor([[-1.0] * 3, [1.0] * 3]), 1e-15)
    elif kind == "block":
        assert bool((affine.scale == 5.0).all())
        assert float(corners.abs().max()) == 1.0
        close(corners.mean(0) + 1, torch.ones(3), 1e-15)
    else:
        assert torch.equal(affine(x), x)


def test_a_component_that_does_not_vary_is_refused_with_its_ranges():
    affine = Affine("minmax", 2)
    with pytest.raises(UserError, match=r"minmax.*received ranges \[1.0, 0.0\]"):
        affine.fit(torch.tensor([0.0, 2.0]), torch.tensor([1.0, 2.0]))
    with pytest.raises(UserError, match="received 'max'"):
        Affine("max", 2)


def test_constants_of_a_scaling_travel_with_the_checkpoint(cache):
    affine = Affine("minmax", 1).double()
    statistics = data_module(SPRING, cache).statistics()
    affine.fit(statistics.minimum[:1], statistics.maximum[:1])
    other = Affine("minmax", 1).double()
    other.load_state_dict(affine.state_dict())
    assert torch.equal(other.scale, affine.scale)
    assert torch.equal(other.shift, affine.shift)


@pytest.mark.parametrize(
    ("small", "scale"), [(2.1e-3, 1.0), (1.9e-3, 9.5e-4), (2.1e-9, 1.05e-9), (1.9e-9, 1.0), (0.0, 1.0)]
)
def test_a_component_that_one_scale_would_hide_has_its_own_unless_it_is_rounding(small, scale):
    affine = Affine("block", 2).double()
    affine.fit(torch.zeros(2, dtype=torch.float64), torch.tensor([2.0, small], dtype=torch.float64))
    close(affine.scale, torch.tensor([1.0, scale], dtype=torch.float64), 1e-14)


@pytest.mark.parametrize(
    ("scaling", "ends"), [("minmax", [1.0, 1.0]), ("block", [1.0, 0.5]), ("none", [4.0, 2.0])]
)
def test_positions_are_scaled_by_their_own_range_and_not_by_that_of_momenta(scaling, ends):
    inputs = position_inputs("cartesian", 2, scaling).double()
    least, most = torch.tensor([-4.0, -2.0, -0.1, -0.3]), torch.tensor([4.0, 2.0, 0.2, 0.4])
    one = torch.zeros(1, 2)
    inputs.fit(Statistics(least, most, most, most, torch.tensor([0.1, 5.0]), one, one, one, one[:, :1], 0.1))
    close(inputs(most[:2].double()), torch.tensor(ends), 1e-6)
    close(inputs(least[:2].double()), -torch.tensor(ends), 1e-6)
