"""Learned constants with their standard deviations."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import generator

from ahnn.dynamics import make_dynamics
from ahnn.uncertainty.constants import Constant, learned_constants

DOUBLE = {"dtype": torch.float64}


def dynamics(dof=2):
    torch.manual_seed(0)
    return make_dynamics(
        "hamiltonian",
        dof=dof,
        inertia=1.0,
        hamiltonian="mechanical",
        mu=None,
        inputs="cartesian",
        scaling="none",
        network={"width": 3, "depth": 1, "activation": "tanh"},
        integrator={"name": "rk4"},
        forces={"friction": {}, "push": {"kind": "actuation"}},
        controls=1,
    ).double()


def test_constants_have_the_deviations_of_their_parameters():
    """A coefficient exp(theta) moves by itself times as much as theta, an entry of G by its unit."""
    made = dynamics()
    made.field.forces["friction"].log_coefficient.data = torch.tensor([0.2, 3.0], **DOUBLE).log()
    made.field.forces["push"].unit.fill_(4.0)
    made.field.forces["push"].weight.data = torch.tensor([[1.0], [-0.5]], **DOUBLE)
    sizes = {name: p.numel() for name, p in made.named_parameters()}
    spread = torch.randn(sum(sizes.values()), 5, generator=generator(0), **DOUBLE)
    rows = dict(zip(sizes, spread.norm(dim=1).split([*sizes.values()]), strict=True))
    friction, push = rows["field.forces.friction.log_coefficient"], rows["field.forces.push.weight"]
    found = learned_constants(made, spread)
    expected = {
        "friction.coefficient[1]": (0.2, 0.2 * float(friction[0])),
        "friction.coefficient[2]": (3.0, 3.0 * float(friction[1])),
        "push.matrix[1]": (4.0, 4.0 * float(push[0])),
        "push.matrix[2]": (-2.0, 4.0 * float(push[1])),
    }
    assert {one.name: (one.value, one.deviation) for one in found} == {
        name: pytest.approx(pair, rel=1e-12) for name, pair in expected.items()
    }
    assert [one.numbers() for one in learned_constants(made, None)] == [[one.value, None] for one in found]
    single = [one.name for one in learned_constants(dynamics(1), None)]
    assert single == ["friction.coefficient", "push.matrix"]
    assert found[0].numbers() == [found[0].value, found[0].deviation]


@pytest.mark.parametrize(
    ("value", "deviation", "text"),
    [
        (0.123456, 0.00123, "a 0.1235 ± 0.0012"),
        (123.456, 0.5, "a 123.5 ± 0.5"),
        (-2.0, 0.25, "a -2 ± 0.25"),
        (1.234, 50.0, "a 1.2 ± 50"),
        (0.0, 0.5, "a 0 ± 0.5"),
        (1.23456789, math.nan, "a 1.23457"),
        (1.23456789, 0.0, "a 1.23457"),
    ],
)
def test_a_constant_has_the_digits_that_its_deviation_leaves(value, deviation, text):
    assert str(Constant("a", value, deviation)) == text
