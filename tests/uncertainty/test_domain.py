"""Novelty: 0 on what is kept, 1 at the edge, growing with the distance, blind to what is known exactly."""

from __future__ import annotations

import pytest
import torch
from helpers import build_model, close, data_module, random_states, ready_model
from hypothesis import given
from hypothesis import strategies as st
from oscillators import Swing

import ahnn
from ahnn.errors import UserError
from ahnn.pretrained import names
from ahnn.systems import Kepler, MassSpring
from ahnn.uncertainty import domain_of, find_domain, growth

SPRING = MassSpring(name="spring", dt=0.01, steps=40)
KEPLER = Kepler(name="kepler", dt=0.05, steps=40)
KINDS = ("mlp", "node", "generic", "separable", "mechanical", "central_body")


def ring(count: int, seed: int) -> torch.Tensor:
    """States of springs of amplitude 0.6 to 1.2: a ring, with nothing in its middle."""
    draw = torch.rand(2, count, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    angle, radius = 6.283 * draw[0], 0.6 + 0.6 * draw[1]
    return torch.stack((radius * angle.cos(), radius * angle.sin()), dim=-1)


class Bare(torch.nn.Module):
    """Dynamics whose networks see the state as it is."""

    seen = Swing.seen


RING = find_domain(Bare(), ring(5_000, 0))  # pyright: ignore[reportArgumentType]


def test_one_training_state_in_a_hundred_is_beyond_one_and_so_are_unseen_ones():
    domain = find_domain(Bare(), ring(20_000, 0))
    assert float((domain.novelty(Bare(), ring(20_000, 0)) > 1).double().mean()) == pytest.approx(
        0.01, abs=1e-3
    )
    unseen = domain.novelty(Bare(), ring(20_000, 1))
    assert 0.005 < float((unseen > 1).double().mean()) < 0.02
    assert float(unseen.max()) < 1.5
    assert float(domain.novelty(Bare(), domain.states).max()) == 0.0


@given(st.floats(0.0, 0.4), st.floats(1.5, 50.0), st.floats(0.0, 6.28))
def test_the_middle_of_a_ring_is_as_novel_as_its_outside(inner, outer, angle):
    """What the mean and covariance of the data would call typical; the distance is that from the ring."""
    domain = RING
    direction = torch.tensor([[angle]], dtype=torch.float64)
    unit = torch.cat((direction.cos(), direction.sin()), dim=-1)
    for radius, distance in ((inner, 0.6 - inner), (outer, outer - 1.2)):
        found = float(domain.novelty(Bare(), radius * unit)[0]) * domain.unit
        assert distance - 0.02 <= found <= distance + 0.05
        assert found > domain.unit


@pytest.mark.parametrize("kind", KINDS)
def test_novelty_is_measured_in_what_the_networks_see(kind, cache):
    data = data_module(KEPLER, cache, steps=40)
    model = ready_model(kind, data)
    dynamics, x = model.dynamics.frozen(), random_states(KEPLER, 50, 3)
    domain = find_domain(dynamics, data.examples())
    kicked = torch.cat((x[:, :2], 3.0 * x[:, 2:]), dim=-1)
    moved = torch.cat((5.0 * x[:, :2], x[:, 2:]), dim=-1)
    blind = kind in ("mechanical", "central_body")  # the kinetic energy is known, whatever the momenta
    assert bool((domain.novelty(dynamics, kicked) == domain.novelty(dynamics, x)).all()) is blind
    assert float(domain.novelty(dynamics, moved).min()) > 1.0
    direct = torch.cdist(dynamics.seen(x), dynamics.seen(domain.states)).amin(-1) / domain.unit
    close(domain.novelty(dynamics, x), direct, 1e-6)
    assert domain.novelty(dynamics, x.reshape(5, 10, 4)).shape == (5, 10)


def test_it_travels_as_plain_values():
    domain = find_domain(Bare(), ring(5_000, 0))
    again = domain_of({"domain": domain.about()}, 2)
    assert again is not None
    close(again.novelty(Bare(), ring(99, 2)), domain.novelty(Bare(), ring(99, 2)), 1e-6)
    assert domain_of({}, 2) is None


WRONG = (
    {},
    {"unit": 0.0, "states": [[1.0, 2.0]]},
    {"unit": 1, "states": [[1.0]]},
    {"unit": 1, "states": "a"},
    {"unit": 1, "states": [[1.0, None]]},
)


@pytest.mark.parametrize("wrong", WRONG)
def test_a_damaged_one_is_one_message(wrong):
    with pytest.raises(UserError, match=r"domain.*: expected (training states|key|float|a list)"):
        domain_of({"domain": wrong}, 2)


@pytest.mark.parametrize("count", [1, 2, 3, 50, 700])
def test_of_few_states_half_are_kept(count):
    domain = find_domain(Bare(), ring(count, 0))
    assert len({tuple(row) for row in domain.states.tolist()}) == max(1, min(500, count // 2))
    assert domain.unit > 0


def test_dense_data_make_no_neighbour_novel():
    line = torch.linspace(-1, 1, 20_000, dtype=torch.float64).unsqueeze(-1).expand(-1, 2)
    domain = find_domain(Bare(), line)
    assert domain.unit == pytest.approx(0.04)
    assert float(domain.novelty(Bare(), 1.02 * line[-1:])[0]) < 1
    assert float(domain.novelty(Bare(), 1.1 * line[-1:])[0]) > 2


def test_growth_is_one_within_and_begins_gently_beyond():
    close(
        growth(torch.tensor([0.0, 1.0, 1.1, 2.0, 4.0]), 10.0), torch.tensor([1.0, 1.0, 1.1, 11.0, 91.0]), 1e-6
    )


@pytest.mark.parametrize("name", names())
def test_shipped_models_know_where_they_were_trained(name):
    run = ahnn.load(name)
    start = torch.tensor([0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0], dtype=torch.float64)
    assert float(run.novelty(start)) < 1.0
    assert float(run.novelty(1.5 * start)) > 1.5


def test_weights_of_an_earlier_version_say_so(cache):
    data = data_module(SPRING, cache, steps=20)
    model = build_model("generic", SPRING)
    model.calibrate(data.statistics())
    run = ahnn.Run(model.dynamics.frozen(), SPRING.space, 0.01, {}, folder=None)  # pyright: ignore
    with pytest.raises(UserError, match=r"novelty: expected weights with their training domain"):
        run.novelty([0.1, 0.2])
