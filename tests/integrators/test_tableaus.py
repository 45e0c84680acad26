"""Coefficients satisfy their own order conditions; what cannot be integrated is refused by name."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch
from helpers import SPRING, SYSTEMS, build_model, random_states

from ahnn.errors import UserError
from ahnn.integrators import (
    INTEGRATORS,
    ExplicitRungeKutta,
    GaussLegendre4,
    SymmetricComposition,
    make_integrator,
)

EXPLICIT = [n for n, m in INTEGRATORS.items() if isinstance(m, ExplicitRungeKutta)]
COMPOSED = [n for n, m in INTEGRATORS.items() if isinstance(m, SymmetricComposition)]

# Nodes as the sources print them; the code keeps only their row sums.
NODES = {
    "midpoint": [0, 1 / 2],
    "rk4": [0, 1 / 2, 1 / 2, 1],
    "dopri5": [0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1],
    "dopri8": [
        0,
        1 / 18,
        1 / 12,
        1 / 8,
        5 / 16,
        3 / 8,
        59 / 400,
        93 / 200,
        5490023248 / 9719169821,
        13 / 20,
        1201146811 / 1299019798,
        1,
        1,
    ],
}


@pytest.mark.parametrize("name", EXPLICIT)
def test_output_weights_integrate_powers_up_to_the_order(name):
    method = INTEGRATORS[name]
    c = [0.0, *(sum(row) for row in method.tableau.a)]
    assert len(method.tableau.b) == len(c)
    for k in range(1, method.order + 1):
        assert (
            abs(sum(b * node ** (k - 1) for b, node in zip(method.tableau.b, c, strict=True)) - 1 / k) < 1e-13
        )


@pytest.mark.parametrize("name", NODES)
def test_row_sums_are_the_published_nodes(name):
    rows = INTEGRATORS[name].tableau.a
    assert [len(row) for row in rows] == list(range(1, len(rows) + 1))
    for row, node in zip(rows, NODES[name][1:], strict=True):
        assert abs(sum(row) - node) < 1e-14


@pytest.mark.parametrize("name", COMPOSED)
def test_composition_weights_are_a_palindrome_of_sum_one(name):
    drifts, kicks = INTEGRATORS[name].weights
    assert abs(sum(kicks) - 1) < 1e-14
    assert abs(sum(drifts) - 1) < 1e-14
    assert drifts == drifts[::-1]
    assert kicks == kicks[::-1]
    assert drifts[1:-1] == tuple((a + b) / 2 for a, b in pairwise(kicks))


@pytest.mark.parametrize("name", COMPOSED)
def test_a_composition_refuses_a_field_that_is_not_separable_by_name(name):
    field = build_model("generic", SPRING).dynamics.field
    with pytest.raises(UserError, match=rf"{name}.*GenericHamiltonian.*rk4 or gl4"):
        INTEGRATORS[name].step(field, torch.zeros(1, 2), 0.1)


def test_a_composition_takes_a_learned_separable_hamiltonian():
    field = build_model("separable", SPRING).dynamics.field
    assert INTEGRATORS["leapfrog"].step(field, torch.ones(1, 2), 0.1).shape == (1, 2)


def test_gl4_says_when_it_does_not_converge():
    x = random_states(SPRING, 3, seed=0)
    with pytest.raises(UserError, match=r"gl4: the stages of 3 of 3 states.*2 sweeps"):
        GaussLegendre4(max_iterations=2).step(SPRING, x, 0.01)
    with pytest.raises(UserError, match="did not converge in 50 sweeps"):
        GaussLegendre4().step(SPRING, x, 5.0)  # h * Lipschitz constant / sqrt(12) > 1: no contraction


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_gl4_keeps_members_apart_from_a_non_finite_one(bad):
    system = SYSTEMS["kepler"]
    x = random_states(system, 6, seed=1)
    spoilt = x.clone()
    spoilt[2, 0] = bad
    clean, result = GaussLegendre4().step(system, x, 0.05), GaussLegendre4().step(system, spoilt, 0.05)
    others = torch.arange(6) != 2
    assert torch.equal(result[others], clean[others])
    assert not bool(result[2].isfinite().all())


def test_gl4_gives_a_member_the_same_bits_alone_and_in_company():
    system = SYSTEMS["kepler"]
    x = random_states(system, 6, seed=2)
    together = GaussLegendre4().step(system, x, 0.05)
    alone = torch.cat([GaussLegendre4().step(system, x[b : b + 1], 0.05) for b in range(6)])
    assert torch.equal(together, alone)


def test_make_integrator_names_the_nearest_method_and_the_options():
    assert make_integrator("rk4") is INTEGRATORS["rk4"]
    assert make_integrator("gl4", tolerance=1e-8, max_iterations=7) == GaussLegendre4(1e-8, 7)
    with pytest.raises(UserError, match="did you mean yoshida4"):
        make_integrator("yosida4")
    with pytest.raises(UserError, match="unknown option 'tolerance'"):
        make_integrator("rk4", tolerance=1e-8)
    with pytest.raises(UserError, match="tolerance"):
        make_integrator("gl4", tolerance=0.0)
