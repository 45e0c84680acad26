"""Coordinates whose energies differ by orders of magnitude have units of a network of their own."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator

from ahnn.dynamics.energies import NetworkEnergy
from ahnn.dynamics.energy_levels import levels, units_of
from ahnn.dynamics.hamiltonians import make_hamiltonian
from ahnn.dynamics.inputs import position_inputs
from ahnn.statistics import Statistics
from ahnn.training.normal_equations import damped_step, normal_equations

RATIO = 1e-6
NETWORK = {"width": 12, "depth": 2, "activation": "tanh"}
DOUBLE = {"dtype": torch.float64}


def statistics(ratio):
    """Oscillators of frequency 1 and ranges 1 whose masses, and so energies, are 1, the ratio and 1."""
    sizes = torch.tensor([1, 1, 1, 1, ratio, 1], **DOUBLE)
    q = torch.zeros(2, 3, **DOUBLE)
    return Statistics(-sizes, sizes, 0.1 * sizes, sizes, q[0, :2], q, q, q, q[:, :1], 0.1)


def fitted(inputs, ratio, times=1):
    torch.manual_seed(0)
    options = {"mass": 1.0, "mu": None, "scaling": "block", "network": NETWORK}
    made = make_hamiltonian("generic", 3, inputs=inputs, angular=[True, False, False], **options).double()
    with torch.no_grad():
        for _ in range(times):
            made.fit(statistics(ratio))
    return made


def test_levels_are_the_largest_energies_of_those_that_are_alike():
    found = levels(torch.tensor([0.5, 50.0, 1.0, 0.4, 1e-3, 0.0], **DOUBLE))
    assert found.tolist() == [0.02, 1.0, 0.02, 0.02, 2e-5, 1.0]


@pytest.mark.parametrize("inputs", ["cartesian", "angles"])
def test_fresh_weights_move_each_momentum_at_its_own_rate(inputs):
    """As even coordinates do, but for a factor; one unit of energy for all is off by six decades."""
    even, uneven = fitted(inputs, 1.0), fitted(inputs, RATIO)
    z = 2 * torch.rand(500, 6, generator=generator(1), **DOUBLE) - 1
    sizes = statistics(RATIO).maximum
    with torch.no_grad():
        rates, expected = uneven(z * sizes) / sizes, even(z)
    assert float((rates.norm(dim=0) / expected.norm(dim=0)).log10().abs().max()) < 1.5


def test_a_light_coordinate_feels_heavy_ones_and_hardly_moves_them():
    made = fitted("cartesian", RATIO)
    x = (torch.rand(6, generator=generator(2), **DOUBLE) - 0.5) * statistics(RATIO).maximum
    bent = torch.autograd.functional.jacobian(made, x) / statistics(RATIO).maximum.unsqueeze(1)
    assert float(bent[3:, 1].abs()[[0, 2]].max()) < 10 * RATIO
    assert float(bent[4, [0, 2]].abs().max()) > 1e-3


def test_even_coordinates_leave_weights_as_they_are_and_a_second_fit_changes_nothing():
    even = fitted("cartesian", 0.04)
    torch.manual_seed(0)
    options = {"mass": 1.0, "mu": None, "inputs": "cartesian", "scaling": "block", "network": NETWORK}
    fresh = make_hamiltonian("generic", 3, **options).double()
    assert all(torch.equal(a, b) for a, b in zip(even.parameters(), fresh.parameters(), strict=True))
    assert units_of(even.parameters()) is None
    once, twice = fitted("cartesian", RATIO), fitted("cartesian", RATIO, 2)
    assert (
        float(units_of(once.parameters()).max()) == 1.0
    )  # heavy coordinates are not moved more by light ones
    for a, b in zip(once.parameters(), twice.parameters(), strict=True):
        close(a, b, 1e-14)


def test_inputs_that_mix_coordinates_have_one_level():
    energy = NetworkEnergy(position_inputs("isotropic", 3, "block"), NETWORK, 0).double()
    energy.fit(statistics(RATIO)._replace(radius=torch.tensor([0.5, 1.0], **DOUBLE)))
    assert units_of(energy.parameters()) is None


def test_a_step_in_units_is_that_of_parameters_in_these_units():
    rng = generator(3)
    jacobian, residuals = torch.randn(9, 4, generator=rng, **DOUBLE), torch.randn(9, generator=rng, **DOUBLE)
    units, theta = torch.tensor([1.0, 1e-6, 1e-3, 1.0], **DOUBLE), torch.zeros(4, **DOUBLE)
    scaled = damped_step(normal_equations(jacobian, residuals, [4]), 1.0, theta)
    blocks = normal_equations(jacobian / units, residuals, [4])
    step = damped_step([block._replace(units=units[block.columns]) for block in blocks], 1.0, theta)
    close(step / units, scaled, 1e-9)
