"""From options of the process noise to Q and a force error, where they say all of it."""

from __future__ import annotations

import pytest
import torch

from ahnn.estimation.force_error import ForceError
from ahnn.evaluation.estimators.noise_options import (
    ForceOptions,
    ParameterOptions,
    given_noise,
    noise_option,
    without_parameters,
)
from ahnn.types import Space

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
    ],
)
def test_what_is_not_said_is_left_to_data(option):
    assert given_noise(noise_option(option), SPACE) is None


def test_words_stand_for_force_errors():
    assert noise_option("force_error") == ForceOptions()
    assert isinstance(noise_option("parameter_error"), ParameterOptions)


def test_a_flow_without_parameters_has_a_force_error_in_their_place():
    assert without_parameters(noise_option("parameter_error")) == ForceOptions()
    for option in ("fitted", "force_error", (0.5, 0.1), {"size": 0.01}):
        assert without_parameters(noise_option(option)) == noise_option(option)
