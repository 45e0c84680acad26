"""Fields of the systems are the derivatives of their energies; J2 agrees with 40-digit values."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from helpers import MOLNIYA, SYSTEMS, close, random_states

from ahnn.errors import UserError

# Potential (km^2/s^2) and acceleration (km/s^2) of the J2 field, computed with 40 digits.
J2_VALUES = [
    (
        (4000.0, -3000.0, 5000.0),
        -56.358202029360426486,
        (-0.00450071181240558433, 0.00337553385930418824, -0.00564078542165057377),
    ),
    (
        (-7000.0, 100.0, -1500.0),
        -55.694260631116825612,
        (0.00761034865445969038, -0.000108719266492281291, 0.00163498812815009699),
    ),
]


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_field_is_hamiltons(name):
    system = SYSTEMS[name]
    for x in random_states(system, 50, seed=3):
        x = x.requires_grad_()
        (gradient,) = torch.autograd.grad(system.energy(x), x)
        dq, dp = gradient.chunk(2)
        q, p = x.detach().chunk(2)
        close(system.force(q), -dq, 1e-10)
        close(system.velocity(p), dp, 1e-10)
        assert torch.equal(system(x.detach()), torch.cat((system.velocity(p), system.force(q))))


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_batch_of_any_shape_gives_the_same_field(name):
    system = SYSTEMS[name]
    x = random_states(system, 6, seed=4)
    close(system(x.view(2, 3, -1)).view(6, -1), system(x), 1e-15)
    assert system.energy(x.view(2, 3, -1)).shape == (2, 3)


@pytest.mark.parametrize(("q", "potential", "acceleration"), J2_VALUES)
def test_j2_field_agrees_with_forty_digit_values(q, potential, acceleration):
    q = torch.tensor(q, dtype=torch.float64)
    at_rest = torch.cat((q, torch.zeros(3, dtype=torch.float64)))
    assert float(MOLNIYA.energy(at_rest)) == pytest.approx(potential, rel=1e-15)
    expected = torch.tensor(acceleration, dtype=torch.float64)
    close(MOLNIYA.force(q), expected, 1e-15)
    heavy = dataclasses.replace(MOLNIYA, mass=2.0)
    close(heavy.force(q), 2 * expected, 1e-15)


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_system_describes_its_state(name):
    system = SYSTEMS[name]
    assert len(system.components) == 2 * system.dof
    assert system.deviations().shape == (2 * system.dof,)
    x = random_states(system, 2, seed=0)
    assert x.shape == (2, 2 * system.dof)
    assert x.dtype == torch.float64


@pytest.mark.parametrize("change", [{"dt": 0.0}, {"steps": 0}, {"mass": -1.0}])
def test_impossible_times_and_masses_are_refused(change):
    with pytest.raises(UserError, match=str(next(iter(change.values())))):
        dataclasses.replace(MOLNIYA, **change)
