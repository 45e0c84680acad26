"""Duffing, the chains and the charge: closed forms, invariants and SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from helpers import close, generator
from scipy.integrate import solve_ivp
from torch.func import grad, vmap

from ahnn.data.generate import generate
from ahnn.systems import ChargedParticle, Duffing, FermiPastaChain, TodaChain

GRID = {"dt": 0.05, "steps": 200}
CONSERVATIVE = [
    FermiPastaChain(name="f", masses=4, alpha=0.4, beta=0.7, mass=2.0, **GRID),
    TodaChain(name="t", masses=4, mass=2.0, **GRID),
    ChargedParticle(name="c", charge=1.5, field=0.8, growth=0.6, stiffness=0.3, mass=2.0, **GRID),
    Duffing(name="d", friction=0.0, drive=0.0, mass=2.0, **GRID),
]


@pytest.mark.parametrize("system", CONSERVATIVE, ids=lambda one: one.name)
def test_the_field_is_that_of_the_energy_and_conserves_it(system):
    x = system.initial_states(20, generator(0))
    slope = vmap(grad(system.energy))(x)
    q, p = slope.chunk(2, dim=-1)
    close(system(x), torch.cat((p, -q), dim=-1), 1e-13)
    energies = system.energy(generate(system, 5, 1).states)
    close(energies, energies[:, :1].expand_as(energies), 1e-9)


def test_duffing_follows_its_equation_of_second_order():
    system = Duffing(name="d", mass=2.0, **GRID)
    data = generate(system, 1, 0)

    def rhs(t, y):
        q, v = y
        return v, (q - q**3 - 0.25 * v + 0.3 * math.cos(t)) / 2.0

    q, p = data.states[0].T.numpy()
    exact = solve_ivp(rhs, (0, 10), (q[0], p[0] / 2), t_eval=data.times[0], rtol=1e-12, atol=1e-12).y
    np.testing.assert_allclose(q, exact[0], atol=1e-8)
    np.testing.assert_allclose(p / 2, exact[1], atol=1e-8)


def test_a_chain_without_nonlinear_terms_swings_in_its_normal_modes():
    """w_k = 2 sin(k pi / 2 (n + 1)) for springs of 1 between walls."""
    n = 5
    system = FermiPastaChain(name="f", masses=n, alpha=0.0, beta=0.0, **GRID)
    data = generate(system, 3, 0)
    k = np.arange(1, n + 1)
    modes = np.sqrt(2 / (n + 1)) * np.sin(np.outer(k, k) * np.pi / (n + 1))
    w = 2 * np.sin(k * np.pi / (2 * (n + 1)))
    q0, p0 = np.split(data.states[:, 0].numpy() @ np.kron(np.eye(2), modes), 2, axis=-1)
    t = data.times[0].numpy()[:, None]
    q = q0[:, None] * np.cos(w * t) + p0[:, None] / w * np.sin(w * t)
    np.testing.assert_allclose(data.states[..., :n].numpy(), q @ modes, atol=1e-9)


def test_a_toda_ring_keeps_the_eigenvalues_of_its_lax_matrix():
    """Flaschka 1974: a_i = exp(-r_i / 2) / 2 beside b_i = p_i / 2 on the diagonal."""
    n = 4
    system = TodaChain(name="t", masses=n, **GRID)
    states = generate(system, 3, 0).states
    q, p = states.chunk(2, dim=-1)
    a, b = torch.exp(-(q.roll(-1, -1) - q) / 2) / 2, p / 2
    lax = torch.diag_embed(b)
    for i in range(n):
        j = (i + 1) % n
        lax[..., i, j] += a[..., i]
        lax[..., j, i] += a[..., i]
    eigenvalues = torch.linalg.eigvalsh(lax)
    close(eigenvalues, eigenvalues[:, :1].expand_as(eigenvalues), 1e-8)


def test_a_charge_circles_with_its_cyclotron_frequency():
    system = ChargedParticle(name="c", charge=1.5, field=-0.8, mass=2.0, **GRID)
    data = generate(system, 4, 0)
    start = data.states[:, 0]
    v = torch.complex(*system.velocities(start).unbind(-1))
    w = -1.5 * -0.8 / 2.0  # clockwise for a positive charge in a positive field
    turn = torch.exp(1j * w * data.times)
    exact = torch.complex(*start[:, :2].unbind(-1))[:, None] + v[:, None] * (turn - 1) / (1j * w)
    close(data.states[..., 0], exact.real, 1e-9)
    close(data.states[..., 1], exact.imag, 1e-9)
    close(system.velocities(data.states), torch.view_as_real(v[:, None] * turn), 1e-9)
    assert not system.mechanical
