"""The taper of Gaspari & Cohn, and what it gains on a chain with few members."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from ahnn.errors import UserError
from ahnn.estimation import initial_belief
from ahnn_plugins.enkf import EnsembleKalmanFilter, Localisation, gaspari_cohn

F64, N = torch.float64, 24


class Displacements:
    names, units = tuple(f"q{i}" for i in range(N)), ("m",) * N

    def __call__(self, x, t):
        return x[..., :N]


class Distances(Displacements):
    """The same, told by a function that is not linear."""

    def __call__(self, x, t):
        return torch.sinh(0.1 * x[..., :N]) / 0.1


def test_it_is_the_convolution_of_two_triangles_in_three_dimensions():
    """Their eq. 4.10 is the self-convolution of 1 - r on the ball of half a unit, here by quadrature."""
    grid = np.linspace(-1, 1, 81)
    x, y, z = np.meshgrid(grid, grid, grid, indexing="ij")

    def cone(x):
        return np.clip(1 - 2 * np.sqrt(x**2 + y**2 + z**2), 0, None)

    sums = [float((cone(x) * cone(x - r)).sum()) for r in (0.0, 0.3, 0.5, 0.8, 0.95)]
    ours = gaspari_cohn(torch.tensor([0.0, 0.6, 1.0, 1.6, 1.9, 2.0, 3.0], dtype=F64))
    np.testing.assert_allclose(ours[:5], np.array(sums) / sums[0], atol=2e-3)
    assert ours[5:].tolist() == [0.0, 0.0]
    near = gaspari_cohn(torch.tensor([1 - 1e-9, 1 + 1e-9, 2 - 1e-5], dtype=F64))
    assert float((near[0] - near[1]).abs()) < 1e-8
    assert float(near[2]) < 1e-12


@pytest.mark.parametrize("ring", [False, True])
def test_a_taper_is_one_of_places_on_the_chain_and_positive_definite(ring):
    taper = Localisation(radius=5.0, coordinates=N, ring=ring).taper(2 * N)
    assert torch.equal(taper.diagonal(), torch.ones(2 * N, dtype=F64))
    assert torch.equal(taper[:N, :N], taper[N:, :N])  # q and p of one mass are at one place
    assert not bool(taper[0, 5:15].any())
    assert bool(taper[0, N - 1] > 0) == ring
    assert float(torch.linalg.eigvalsh(taper[:N, :N]).min()) > 0


@pytest.mark.parametrize("model", [Displacements(), Distances()])
@pytest.mark.parametrize("form", ["square_root", "stochastic"])
def test_few_members_follow_a_chain_that_they_lose_without_it(form, model):
    """48 components, 20 members: the belief of independent coordinates is found again."""
    b = 8
    generator = torch.Generator().manual_seed(0)
    truth = torch.randn(b, 2 * N, generator=generator, dtype=F64)
    noise = 0.5 * torch.randn(b, N, generator=generator, dtype=F64)
    belief = initial_belief(torch.zeros(b, 2 * N), torch.eye(2 * N, dtype=F64))
    found = {}
    for radius in (3.0, 1e3):
        enkf = EnsembleKalmanFilter(ensemble=20, form=form, localisation={"radius": radius, "coordinates": N})
        row = model(truth, 0.0) + noise
        state, told = enkf.update(enkf.start(belief), row, model, 0.25 * torch.eye(N, dtype=F64))
        assert not bool(state.status.any())
        found[radius] = float((state.belief.mean - truth)[:, :N].square().mean().sqrt())
        assert bool(told.nis.isfinite().all())
    exact = (0.25 / 1.25) ** 0.5
    assert found[3.0] < 1.25 * exact
    assert found[1e3] > 1.45 * exact


def test_what_has_no_place_on_the_chain_is_refused():
    enkf = EnsembleKalmanFilter(ensemble=5, localisation={"radius": 2, "coordinates": 4})
    with pytest.raises(UserError, match="expected states with a multiple of 4 components"):
        enkf.start(initial_belief(torch.zeros(1, 9), torch.eye(9)))
    with pytest.raises(UserError, match="radius: expected at most 2, half the ring"):
        Localisation(radius=3.0, coordinates=4, ring=True)
    assert not enkf.smoothers
    assert enkf.start(initial_belief(torch.zeros(1, 12), torch.eye(12))).points.shape == (1, 5, 12)
