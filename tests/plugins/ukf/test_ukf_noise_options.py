"""From options of the process noise to Q and a force error, where they say all of it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
import torch

from ahnn.types import Space, Trajectories
from ahnn_plugins.ukf import noise_options
from ahnn_plugins.ukf.force_error import ForceError
from ahnn_plugins.ukf.noise_options import ForceOptions, given_noise, noise_option, product, uncertain

SPACE = Space("orbit", ("x", "y", "z", "px", "py", "pz"), inertia=4.0)


def test_deviations_of_positions_and_velocities_are_those_of_states():
    found = given_noise(noise_option((0.5, 0.1)), SPACE)
    assert found is not None
    q, error = found
    assert error is None
    assert q.tolist() == torch.diag(torch.tensor([0.25] * 3 + [0.4**2] * 3, dtype=torch.float64)).tolist()


def test_a_force_error_that_is_known_needs_no_other_noise():
    found = given_noise(noise_option({"size": 0.01, "memory": 50.0}), SPACE)
    assert found is not None
    q, error = found
    assert torch.equal(q, torch.zeros(6, 6, dtype=torch.float64))
    assert error == ForceError(0.01, 50.0, 4.0, None)


@pytest.mark.parametrize(
    "option",
    [
        "fitted",
        "force_error",
        "parameter_error",
        {"size": 0.01},
        {"memory": 50.0},
        {"size": 0.01, "memory": 50.0, "shape": "parameters"},
    ],
)
def test_what_is_not_said_is_left_to_data(option):
    assert given_noise(noise_option(option), SPACE) is None


def test_words_stand_for_force_errors():
    assert noise_option("force_error") == ForceOptions()
    assert noise_option("parameter_error") == ForceOptions(shape="parameters")


def test_directions_are_weighed_at_about_five_hundred_states_of_the_whole_training(monkeypatch):
    states = torch.arange(4000.0, dtype=torch.float64).view(4, 500, 2)
    states[1, 100:200] = torch.nan
    times = torch.arange(500.0, dtype=torch.float64).expand(4, -1)
    seen = []
    monkeypatch.setattr(noise_options, "force_deviation", lambda *given: seen.append(given))
    known = SimpleNamespace(spread=torch.eye(2))
    case: Any = SimpleNamespace(uncertainty=known, train=Trajectories(states, times), flow=None)
    uncertain(cast(Any, case))
    ((_, spread, some),) = seen
    assert spread is known.spread
    assert 500 <= len(some) <= 1000
    assert bool(some.isfinite().all())
    assert some[:, 0].diff().max() < 0.25 * 4000  # none of the trajectories is left out
    case.train = Trajectories(states[:1, :30], times[:1, :30])
    uncertain(cast(Any, case))
    assert len(seen[1][2]) == 30


def test_factors_on_an_error_are_multiplied():
    double, triple = (lambda x: 2 * x), (lambda x: 3 * x)
    assert product([None, None]) is None
    for factors, expected in (([double, None], 2.0), ([double, triple], 6.0)):
        found = product(factors)
        assert found is not None
        assert float(found(torch.ones(()))) == expected
