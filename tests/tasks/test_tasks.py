"""Tasks of the field: drawings are what their papers say, and scores are those of known predictions."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import close

from ahnn.rollouts import rollout
from ahnn.systems import ChainPendulum, NBody
from ahnn.systems.truth import exact_flow
from ahnn.tasks import TASKS, bodies, chains, comparison, noisy_oscillators
from ahnn.tasks.definition import numbers

DOUBLE = {"dtype": torch.float64}


def turned(x, angle):
    """Motion of q^2 + p^2 for half the angle in time: rotation by the angle."""
    q, p = x[..., :1], x[..., 1:]
    return torch.cat(
        (q * math.cos(angle) + p * math.sin(angle), p * math.cos(angle) - q * math.sin(angle)), -1
    )


def spring(x, steps, dt):
    return torch.stack([turned(x, 2 * dt * k) for k in range(steps + 1)], dim=1)


def test_the_spring_is_its_closed_form_with_the_said_noise(monkeypatch):
    noisy = TASKS["noisy_spring"].draw(3)
    monkeypatch.setattr(noisy_oscillators, "NOISE", 0.0)
    clean = TASKS["noisy_spring"].draw(3).data.states
    assert clean.shape == (50, 30, 2)
    dt = float(noisy.data.times[1])
    close(clean, spring(clean[:, 0], 29, dt), 1e-10)
    radius = clean[:, 0].norm(dim=-1)
    assert 0.1 <= float(radius.min()) < 0.2
    assert 0.9 < float(radius.max()) <= 1.0
    noise = noisy.data.states - clean
    close(noise.std(), torch.tensor(0.1, **DOUBLE), 0.05)
    assert abs(float(noise.mean())) < 0.01
    assert noisy.score(spring) < 1e-20


def test_an_energy_error_is_that_of_a_spiral():
    """Amplitudes that fall by the factor f in each step: known energies at every time."""
    draw = TASKS["noisy_spring"].draw(0)
    found = draw.score(
        lambda x, steps, dt: (
            spring(x, steps, dt) * (0.999 ** torch.arange(steps + 1, **DOUBLE))[None, :, None]
        )
    )
    starts = torch.as_tensor(numbers(0, 1).uniform(-1, 1, (1000, 2)))
    falls = 1 - 0.998001 ** torch.arange(401, **DOUBLE)
    close(
        torch.tensor(found, **DOUBLE), starts.square().sum(-1).square().mean() * falls.square().mean(), 1e-6
    )


def test_the_pendulum_conserves_its_energy(monkeypatch):
    monkeypatch.setattr(noisy_oscillators, "NOISE", 0.0)
    states = TASKS["noisy_pendulum"].draw(1).data.states
    energy = 2 * (1 - states[..., 0].cos()) + states[..., 1].square()
    assert float((energy - energy[:, :1]).abs().max()) < 1e-9
    assert states.shape == (50, 45, 2)


def test_two_bodies_move_on_nearly_circular_orbits_about_their_centre():
    x = bodies.two(400, numbers(0))
    q, v = x[:, :4].unflatten(1, (2, 2)), x[:, 4:].unflatten(1, (2, 2))
    assert float(q.sum(1).abs().max()) < 1e-12
    assert float(v.sum(1).abs().max()) < 1e-12
    radius = q[:, 0].norm(dim=-1)
    circular = v[:, 0].norm(dim=-1) * 2 * radius.sqrt()  # v^2 / r = 1 / (2 r)^2
    close(circular.mean(), torch.tensor(1.0, **DOUBLE), 0.01)
    close(circular.std(), torch.tensor(0.05, **DOUBLE), 0.2)


def test_bodies_are_exact_and_drawn_anew():
    one, again, other = (
        bodies.draw(k, bodies=3, orbits=4, samples=6, duration=0.5, tested=(2, 0.2)) for k in (0, 0, 1)
    )
    assert torch.equal(one.data.states, again.data.states)
    assert not torch.equal(one.data.states, other.data.states)
    system = NBody(name="three", dt=0.1, steps=5)
    energy = system.energy(one.data.states)
    assert float((energy - energy[:, :1]).abs().max()) < 1e-6
    flow = exact_flow(system)
    assert one.score(lambda x, steps, dt: rollout(flow, x, dt, steps + 1)) < 1e-16


@pytest.mark.parametrize(("links", "floor"), [(2, 5.9e-5), (3, 1.1e-4)])
def test_the_floor_of_chains_is_the_published_one_of_a_start_off_by_a_ten_thousandth(
    links, floor, monkeypatch
):
    """Within a factor of three: masses and lengths are drawn."""
    for name, value in (("CHUNKS", 16), ("LATEST", 20), ("TESTED", 40)):
        monkeypatch.setattr(chains, name, value)
    draw = chains.draw(1, links=links)
    generator = numbers(1)
    masses, lengths = generator.uniform(0.6, 1.4, (2, links))
    options = {"masses": masses.tolist(), "lengths": lengths.tolist()}
    flow = exact_flow(ChainPendulum(name="c", links=links, gravity=1.0, dt=0.03, steps=100, **options))
    exact = draw.score(lambda x, steps, dt: rollout(flow, x, dt, steps + 1))
    assert exact < 1e-9
    off = draw.score(lambda x, steps, dt: rollout(flow, x + 1e-4 * torch.randn_like(x), dt, steps + 1))
    assert floor / 3 < off < 3 * floor
    chunks = draw.data.states
    assert chunks.shape == (20, 5, 2 * links)
    close(chunks, rollout(flow, chunks[:, 0], 0.03, 5), 1e-9)


def test_a_table_compares_with_floors_of_the_draws_where_nothing_was_published():
    task = TASKS["one_orbit"]
    floors = {1.0: 0.04, 3.0: 0.02, 2.0: 0.08}
    found = [{"score": s, "seconds": 2.0, "floor": f, "mean": 7.0} for s, f in floors.items()]
    text = comparison.table("one_orbit", task, {"network": found, "gaussian_process": found[:2]})
    assert "published: plots only; floor 0.04 (0.02 to 0.08)" in text
    rows = [line.split() for line in text.splitlines()]
    assert ["network", "2", "1", "to", "3", "3", "2", "50"] in rows
    assert ["-", "mean", "7", "7", "to", "7"] in rows
    assert "verdict" not in text


def test_a_verdict_counts_the_draws_that_are_better_than_the_best_published_score():
    task = TASKS["two_bodies"]
    scores = {"pairs": [{"score": s, "seconds": 2.0} for s in (1e-5, 3e-5, 4e-5)]}
    assert "verdict: better than HNN: pairs in 2 of 3 draws." in comparison.table("two_bodies", task, scores)


def test_a_table_has_median_and_range_beside_what_was_published():
    task = TASKS["two_bodies"]
    scores = {"pairs": [{"score": s, "seconds": 2.0} for s in (1e-5, 3e-5, 2e-5)]}
    text = comparison.table("two_bodies", task, scores)
    assert "2e-05        1e-05 to 3e-05      3        2" in text
    assert "published: baseline 0.063, HNN 3.9e-05" in text
    assert "0.51" in text  # of HNN's
    assert "no training run is finished" in comparison.table("two_bodies", task, {})
    for name, other in TASKS.items():
        assert max(map(len, comparison.table(name, other, scores).splitlines())) <= 80
