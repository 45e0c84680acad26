"""Constants of energies are fitted to the sampled rates: units, and the strength of a central body."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import TINY, close, generator

from ahnn.dynamics.energies import SLIGHT, CentralBody, NetworkEnergy, Quadratic, energy_units
from ahnn.dynamics.hamiltonians import make_hamiltonian
from ahnn.dynamics.inputs import Cartesian, Isotropic, position_inputs
from ahnn.errors import UserError
from ahnn.statistics import Statistics

DOF = 3


def statistics(seed=0, mass=1.0, mu=5.0, extra=0.0, count=200):
    """Statistics of positions under an attraction mu m / r^2, plus forces of the size `extra`."""
    rng = generator(seed)
    q = 3 * torch.randn(count, DOF, generator=rng, dtype=torch.float64) + 1.0
    r = q.norm(dim=-1, keepdim=True)
    forces = -mass * mu * q / r**3 + extra * torch.randn(q.shape, generator=rng, dtype=torch.float64)
    low = torch.tensor([-4.0, -3.0, -2.0, -0.5, -0.4, -0.7], dtype=torch.float64)
    high = torch.tensor([6.0, 5.0, 8.0, 0.3, 0.6, 0.5], dtype=torch.float64)
    rate = torch.tensor([0.3, 0.2, 0.5, 0.07, 0.05, 0.02], dtype=torch.float64)
    radius = torch.stack((r.min(), r.max()))
    return Statistics(low, high, 0.1 * rate, rate, radius, q, forces, forces, q[:, :1], 0.1)


def body(mass=1.0, mu=None, falloff=0.0):
    torch.manual_seed(0)
    remainder = NetworkEnergy(Cartesian(DOF, "block", 0), TINY, 0, falloff)
    made = CentralBody(remainder, mass, mu).double()
    return made


def test_energy_units_are_rates_of_one_block_times_half_ranges_of_the_other():
    potential, kinetic = energy_units(statistics())
    assert float(potential) == pytest.approx((0.07 * 5 + 0.05 * 4 + 0.02 * 5) / 3, rel=1e-14)
    assert float(kinetic) == pytest.approx((0.3 * 0.4 + 0.2 * 0.5 + 0.5 * 0.6) / 3, rel=1e-14)
    torch.manual_seed(0)
    for block, unit in enumerate((potential, kinetic)):
        energy = NetworkEnergy(Cartesian(DOF, "block", block), TINY, block).double()
        energy.fit(statistics())
        close(energy.unit, unit, 1e-14)
    options = {"mass": 1.0, "mu": None, "inputs": "cartesian", "scaling": "block", "network": TINY}
    generic = make_hamiltonian("generic", DOF, **options).double()
    with torch.no_grad():
        generic.fit(statistics())
    close(generic.unit, (potential * kinetic).sqrt(), 1e-14)


@pytest.mark.parametrize("mass", [1.0, 2.5])
def test_mu_is_the_median_of_what_single_forces_say(mass):
    sampled = statistics(mass=mass, extra=0.05)
    learned = body(mass)
    learned.fit(sampled)
    said = []
    for x, force in zip(sampled.positions, sampled.forces, strict=True):
        design = -mass * x / x.norm() ** 3
        said.append(float(torch.linalg.lstsq(design.unsqueeze(-1), force.unsqueeze(-1)).solution))
    close(learned.mu, torch.tensor(said).double().median(), 1e-6)


@pytest.mark.parametrize("mass", [1.0, 2.5])
def test_large_forces_that_are_wrong_do_not_move_mu(mass):
    sampled = statistics(mass=mass)
    low = sampled.positions.norm(dim=-1)
    wrong = torch.where((low < low.quantile(0.1)).unsqueeze(-1), 0.8, 1.0)
    exactly = body(mass)
    exactly.fit(sampled._replace(forces=wrong * sampled.forces))
    assert float(exactly.mu.detach()) == pytest.approx(5.0, rel=1e-12)


@pytest.mark.parametrize("falloff", [0.0, 3.0])
@pytest.mark.parametrize(("mass", "mu"), [(1.0, None), (2.5, None), (2.5, 4.0), (1.0, 5.0)])
def test_the_unit_of_the_remainder_is_the_energy_that_a_point_mass_leaves(mass, mu, falloff):
    sampled = statistics(mass=mass, extra=0.05)
    fitted = body(mass, mu, falloff)
    fitted.fit(sampled)
    strength = float(fitted.mu.detach()) if mu is None else mu
    squares, seen = [], []
    for q, force in zip(sampled.positions, sampled.forces, strict=True):
        r = float(q.norm())
        left = force + mass * strength * q / r**3
        squares += [(float(component) * r) ** 2 for component in left]
        seen += DOF * [(float(sampled.radius[0]) / r) ** (2 * falloff)]
    close(fitted.remainder.unit, torch.tensor((sum(squares) / sum(seen)) ** 0.5), 1e-7)


@pytest.mark.parametrize("falloff", [0.0, 3.0])
@pytest.mark.parametrize(("noise", "hidden"), [(0.05, True), (0.04, True), (0.025, False)])
def test_noise_that_hides_a_remainder_does_not_set_its_unit(noise, hidden, falloff):
    sampled = statistics(extra=0.05)
    noisy, plain = body(1.0, 5.0, falloff), body(1.0, 5.0, falloff)
    noisy.fit(sampled._replace(force_sd=torch.full_like(sampled.forces, noise)))
    plain.fit(sampled)
    slight = []
    for q in sampled.positions:
        r = float(q.norm())
        slight.append(((SLIGHT * 5.0 / r) ** 2, DOF * (float(sampled.radius[0]) / r) ** (2 * falloff)))
    unit = (sum(a for a, _ in slight) / sum(b for _, b in slight)) ** 0.5
    close(noisy.remainder.unit, torch.tensor(unit) if hidden else plain.remainder.unit, 1e-7)


def test_nothing_is_left_of_exact_data():
    fitted = body(2.0, 5.0)
    fitted.fit(statistics(mass=2.0))
    assert float(fitted.remainder.unit) < 1e-12
    q = statistics().positions
    close(fitted(q), -2.0 * 5.0 / q.norm(dim=-1), 1e-10)


def test_data_without_an_attraction_are_refused():
    with pytest.raises(UserError, match=r"expected an attraction; received data with mu=-5"):
        body().fit(statistics(mu=-5.0))


def test_the_kinetic_energy_of_a_known_mass():
    p = torch.tensor([[3.0, 4.0], [0.0, 2.0]], dtype=torch.float64)
    close(Quadratic(2.5)(p), torch.tensor([5.0, 0.8], dtype=torch.float64), 1e-15)
    close(Quadratic(2.5).gradient(p), p / 2.5, 1e-15)


@pytest.mark.parametrize("low", [0.01, 0.5, 3.0])
def test_isotropic_inputs_are_fitted_at_any_distance_from_the_centre(low):
    radius = torch.tensor([low, 4 * low], dtype=torch.float64)
    inputs = Isotropic(DOF).double()
    inputs.fit(statistics()._replace(radius=radius))
    direction = torch.tensor([[0.6, 0.0, -0.8]], dtype=torch.float64)
    got = inputs(torch.cat((low * direction, 2 * low * direction, 4 * low * direction)))
    close(got[:, 3], torch.tensor([-1.0, 0.0, 1.0], dtype=torch.float64), 1e-12)
    for wrong in ([0.0, 1.0], [2.0, 2.0]):
        with pytest.raises(UserError, match="expected distances 0 < low < high"):
            Isotropic(DOF).fit(statistics()._replace(radius=torch.tensor(wrong)))


def test_isotropic_inputs_need_two_dimensions():
    for dof in (2, 3):
        assert isinstance(position_inputs("isotropic", dof, "block"), Isotropic)
    with pytest.raises(UserError, match="at least 2 degrees of freedom; received 1"):
        position_inputs("isotropic", 1, "block")


def test_radial_inputs_pull_toward_the_centre_by_the_derivative_of_their_curve():
    inputs = position_inputs("radial", DOF, "block").double()
    inputs.fit(statistics()._replace(radius=torch.tensor([0.5, 2.0], dtype=torch.float64)))
    q = torch.tensor([[0.3, 0.4, 0.0], [0.0, 0.0, -2.0], [0.6, 0.0, 0.8]], dtype=torch.float64)
    close(inputs(q), torch.tensor([[-1.0], [1.0], [0.0]], dtype=torch.float64), 1e-12)
    slope = torch.tensor([[1.0], [2.0], [3.0]], dtype=torch.float64)
    r = q.norm(dim=-1, keepdim=True)
    close(inputs.linearised(q)[1](slope), slope / (r * math.log(2.0)) * q / r, 1e-14)
    with pytest.raises(UserError, match="radial: expected distances 0 < low < high"):
        inputs.fit(statistics()._replace(radius=torch.tensor([2.0, 2.0])))
    with pytest.raises(UserError, match="inputs radial: expected a system of at least 2"):
        position_inputs("radial", 1, "block")


def test_angles_have_a_period_and_exact_derivatives():
    """Of three coordinates the first and the last are angles."""
    inputs = position_inputs("angles", 3, "minmax", [True, False, True]).double()
    inputs.fit(statistics())
    q = torch.randn(9, 3, generator=generator(1), dtype=torch.float64)
    turned = q + 2 * torch.pi * torch.tensor([3.0, 0.0, -2.0], dtype=torch.float64)
    close(inputs(turned), inputs(q), 1e-14)
    assert inputs.size == 5
    weights = torch.randn(9, 5, generator=generator(2), dtype=torch.float64)

    def along(row, weight):
        return (inputs(row) * weight).sum()

    slope = torch.func.grad(along)
    bent = torch.func.vmap(torch.func.jacrev(slope))(q, weights)
    close(inputs.linearised(q)[1](weights), torch.func.vmap(slope)(q, weights), 1e-13)
    close(inputs.curvature(q, weights), bent, 1e-13)
    with pytest.raises(UserError, match="inputs angles: expected coordinates that are angles"):
        position_inputs("angles", 3, "minmax", [False] * 3)
