"""A Gaussian process in a finite basis: its kernel, its derivatives, its posterior, and what it learns."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from helpers import close, generator, random_states
from torch.func import jacrev, vmap
from torch.nn.utils import parameters_to_vector

from ahnn.data.generate import generate
from ahnn.dynamics import make_dynamics
from ahnn.dynamics.derivatives import field_jacobian, mapped_field_jacobian
from ahnn.dynamics.linearised import linearised
from ahnn.dynamics.networks import make_network
from ahnn.errors import UserError
from ahnn.rollouts import rollout
from ahnn.statistics import Statistics
from ahnn.systems import HenonHeiles
from ahnn.training.evidence import Prior, by_evidence, posterior_factor

DOUBLE = {"dtype": torch.float64}
HEILES = HenonHeiles(name="henon_heiles", dt=0.05, steps=100)
LENGTHS = torch.tensor([0.7, 1.6], **DOUBLE)


def process(count, seed=0, lengths=LENGTHS, outputs=1):
    torch.manual_seed(seed)
    options = {"width": count, "depth": 1, "activation": "fourier"}
    made = make_network(len(lengths), outputs, options).double().requires_grad_(False)
    made.hidden[0].log_lengths.copy_(lengths.log())
    return made


def points(count, seed=1, inputs=2):
    return torch.rand(count, inputs, generator=generator(seed), **DOUBLE) * 2 - 1


def features(made, z):
    """What the weights multiply, (B, 2K)."""
    return made.activation.value(made.hidden[0](z))


def kernel(a, b, lengths=LENGTHS):
    """The squared-exponential kernel of unit amplitude, (A, B)."""
    return (-0.5 * ((a[:, None] - b) / lengths).square().sum(-1)).exp()


def dynamics(hamiltonian="generic", count=12, **options):
    torch.manual_seed(0)
    network = {"width": count, "depth": 1, "activation": "fourier"}
    given = {"inertia": 2.0, "hamiltonian": hamiltonian, "mu": None, "inputs": "cartesian"}
    given |= {"scaling": "minmax", "integrator": {"name": "rk4"}}
    made = make_dynamics("hamiltonian", dof=2, network=network, **given | options).double()
    made.fit(Statistics.of(generate(HEILES, 8, 0)))
    for parameter in made.requires_grad_(False).parameters():
        parameter += 0.3 * torch.randn(parameter.shape, generator=generator(2), **DOUBLE)
    return made


def test_the_kernel_of_the_waves_nears_the_squared_exponential_one():
    """Random frequencies would be off by 1 / sqrt(K) of its size; quasi-random ones are closer."""
    z, off = points(40), []
    exact = kernel(z, z)
    for count in (16, 64, 256, 1024):
        errors = []
        for seed in range(8):
            seen = features(process(count, seed), z)
            errors.append((seen @ seen.T / count - exact).square().mean().sqrt())
        off.append(float(torch.stack(errors).mean()))
        assert off[-1] < count**-0.5
    assert all(after < 0.6 * before for before, after in pairwise(off))


def test_functions_that_are_drawn_have_the_variance_and_the_lengths_of_the_prior():
    made, z, amplitude = process(512), points(1), 1.7
    weights = amplitude / 512**0.5 * torch.randn(4000, 1024, generator=generator(3), **DOUBLE)
    beside = z + 0.4 * LENGTHS * torch.tensor([1.0, 0.0], **DOUBLE)
    here, there = (features(made, at) @ weights.T for at in (z, beside))
    assert float(here.square().mean()) == pytest.approx(amplitude**2, rel=0.1)
    correlation = (here * there).mean() / here.square().mean()
    assert float(correlation) == pytest.approx(math.exp(-0.08), rel=0.02)
    waves = made.hidden[0]
    slopes = weights * torch.cos(waves(z)) @ waves.weight
    close(slopes.square().mean(0).sqrt(), amplitude / LENGTHS, 0.1)


def test_several_outputs_are_processes_of_their_own():
    made, z = process(8, outputs=3), points(5)
    close(made(z), features(made, z) @ made.output.weight.T, 1e-14)
    _, back = made.linearised(z)
    for k, unit in enumerate(torch.eye(3, **DOUBLE)):
        close(back(unit.expand(5, 3)), vmap(jacrev(lambda row, k=k: made(row)[k]))(z), 1e-12)


@pytest.mark.parametrize("inputs", ["cartesian", "angles", "isotropic"])
@pytest.mark.parametrize("hamiltonian", ["generic", "separable", "mechanical", "central_body"])
def test_gradient_hessian_and_rows_are_those_of_autograd(hamiltonian, inputs):
    falls = {"falloff": 3.0} if hamiltonian == "central_body" else {}
    angular = {"angular": [True, False]} if inputs == "angles" else {}
    made = dynamics(hamiltonian, inputs=inputs, **falls, **angular)
    x, field = random_states(HEILES, 20, seed=3), made.field
    of_q, of_p = vmap(jacrev(field.energy))(x).chunk(2, dim=-1)
    close(field(x), torch.cat((of_p, -of_q), dim=-1), 1e-10)
    bent = vmap(jacrev(jacrev(field.energy)))(x)
    if hamiltonian == "generic":
        close(field.derivatives(x)[1], bent, 1e-10)
    else:
        for energy, part in zip(field.energies, (slice(2, 4), slice(0, 2)), strict=True):
            close(energy.derivatives(x[:, part])[1], bent[:, part, part], 1e-10)
    theta = parameters_to_vector(made.parameters())
    found, mapped = (make(made, torch.float64)(theta, x) for make in (field_jacobian, mapped_field_jacobian))
    close(found, mapped, 1e-10)
    assert found.shape[-1] == len(theta)


@pytest.mark.parametrize("hamiltonian", ["generic", "separable", "mechanical"])
def test_a_step_of_functions_is_that_of_the_rows_and_they_stay_what_they_were(hamiltonian):
    made, x = dynamics(hamiltonian), random_states(HEILES, 9, seed=4)
    theta = parameters_to_vector(made.parameters())
    step = torch.randn(theta.shape, generator=generator(5), **DOUBLE)
    rows = field_jacobian(made, torch.float64)(theta, x)
    wide, places = linearised(made, step)
    moved = wide.field(x) - made.field(x)
    close(moved[:, -rows.shape[1] :], rows @ step, 1e-4)
    own = parameters_to_vector(wide.parameters()).detach()
    close(field_jacobian(wide, torch.float64)(own, x)[..., places], rows, 1e-12)


def covariance_of_slopes(a, b, amplitude):
    """Of the gradients of a process at a and at b, (2A, 2B): k (1 / l^2 - d d^T / l^4), d = a - b.

    Solak, Murray-Smith, Leithead, Leith & Rasmussen 2002, NeurIPS.
    """
    a, b, lengths = a.numpy(), b.numpy(), LENGTHS.numpy()
    apart = (a[:, None] - b) / lengths**2
    size = amplitude**2 * np.exp(-0.5 * ((a[:, None] - b) ** 2 / lengths**2).sum(-1))
    blocks = np.diag(lengths**-2) - apart[..., :, None] * apart[..., None, :]
    return (size[..., None, None] * blocks).swapaxes(1, 2).reshape(a.size, b.size)


def textbook(covariance, z, y, at, noise):
    """Mean and covariance of a process at `at`, given noisy values y at z (Rasmussen & Williams 2006)."""
    across, known = covariance(at, z), covariance(z, z) + noise**2 * np.eye(y.numel())
    spread = covariance(at, at) - across @ np.linalg.solve(known, across.T)
    return torch.from_numpy(across @ np.linalg.solve(known, y.numpy().ravel())), torch.from_numpy(spread)


def test_the_posterior_of_the_weights_is_the_textbook_one_of_derivatives():
    """By the machinery of trainings: rows of the gradient, and the prior K / s^2 on the weights."""
    amplitude, noise, count = 1.3, 0.2, 512
    z, at, made = points(12), points(6, seed=6), process(512)
    y = torch.stack((torch.cos(2 * z[:, 0]) * z[:, 1], torch.sin(2 * z[:, 0]) / 2), dim=-1)
    y = y + noise * torch.randn(z.shape, generator=generator(7), **DOUBLE)
    theta = parameters_to_vector(made.parameters())

    def rows(x):
        found = x.new_empty(len(x), 2, len(theta))
        made.write_rows(theta, x, torch.eye(2, **DOUBLE).expand(len(x), -1, -1), None, found)
        return found[..., 2:].flatten(0, 1)

    prior = Prior(torch.tensor([count / amplitude**2], **DOUBLE), (2 * count,))
    seen = rows(z) / noise
    factor = posterior_factor(seen.T @ seen, prior)
    mean = rows(at) @ factor @ (factor.T @ (seen.T @ (y.flatten() / noise)))
    spread = rows(at) @ factor
    spread = spread @ spread.T

    finite = textbook(lambda a, b: (rows(a) @ rows(b).T).numpy() / float(prior.strengths), z, y, at, noise)
    close(mean, finite[0], 1e-8)
    close(spread, finite[1], 1e-8)
    full = textbook(lambda a, b: covariance_of_slopes(a, b, amplitude), z, y, at, noise)
    close(mean, full[0], 0.1)
    close(spread, full[1], 0.15)


def test_the_evidence_finds_the_amplitude_that_functions_were_drawn_with():
    count, amplitude, noise = 64, 1.7, 0.01
    made, z = process(count), points(400)
    weights = amplitude / count**0.5 * torch.randn(2 * count, generator=generator(8), **DOUBLE)
    seen = features(made, z) / noise
    y = seen @ weights + torch.randn(len(z), generator=generator(9), **DOUBLE)
    for _ in range(20):  # of weights and strength in turn
        matrix = seen.T @ seen
        prior = by_evidence(matrix, weights, (2 * count,))
        factor = posterior_factor(matrix, prior)
        weights = factor @ (factor.T @ (seen.T @ y))
    assert (count / float(prior.strengths)) ** 0.5 == pytest.approx(amplitude, rel=0.3)


def test_a_symplectic_method_conserves_the_energy_of_a_drawn_process():
    made = dynamics("separable", scaling="block", integrator={"name": "kahan_li8"}).frozen()
    start = random_states(HEILES, 5, seed=10)
    energy = made.energy(rollout(made, start, 0.05, 50))
    spread = (made.energy(random_states(HEILES, 50, seed=11))).std()
    assert float((energy - energy[:, :1]).abs().max()) < 1e-8 * float(spread)


def test_what_a_process_has_not_is_refused():
    options = {"width": 8, "depth": 2, "activation": "fourier"}
    with pytest.raises(UserError, match="depth: expected 1; received 2"):
        make_network(2, 1, options)
