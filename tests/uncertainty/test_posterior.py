"""The covariance as a file: it comes back as it was, belongs to its weights, and shows damage."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from helpers import close

from ahnn.checkpoints import FORMAT, Weights, read_weights, write_weights
from ahnn.dynamics import make_dynamics
from ahnn.errors import UserError
from ahnn.estimation.parameter_error import field_columns
from ahnn.uncertainty import (
    Uncertainty,
    load_uncertainty,
    rollout_covariances,
    save_uncertainty,
)
from ahnn.uncertainty.posterior import FILE

STATE = {"field.weight": torch.arange(3.0, dtype=torch.float64)}
KNOWN = Uncertainty(
    torch.tensor([[2.0, 1.0], [0.0, 3.0]], dtype=torch.float64),
    torch.tensor([0.5, -1.0], dtype=torch.float64),
    1.5,
    {"determined": 1.25, "strengths": {"field.weight": 0.1}},
)


def test_a_covariance_comes_back_with_its_weights_and_with_no_others(tmp_path):
    assert load_uncertainty(tmp_path, STATE) is None
    save_uncertainty(tmp_path, KNOWN, STATE)
    found = load_uncertainty(tmp_path, STATE)
    assert found is not None
    assert torch.equal(found.factor, KNOWN.factor)
    assert torch.equal(found.offset, KNOWN.offset)
    assert (found.inflation, found.about) == (1.5, KNOWN.about)
    assert load_uncertainty(tmp_path, {"field.weight": STATE["field.weight"] + 1e-12}) is None


def test_the_covariance_is_noise_and_the_step_that_is_left_inflated():
    expected = 1.5 * (torch.tensor([[5.0, 3.0], [3.0, 9.0]]) + torch.tensor([[0.25, -0.5], [-0.5, 1.0]]))
    close(KNOWN.covariance, expected, 1e-12)


@pytest.mark.parametrize("name", ["step", "directions"])
def test_what_not_every_training_has_is_kept(name, tmp_path):
    for part in (None, torch.tensor([[0.25], [4.0]], dtype=torch.float64)):
        given = part.flatten() if part is not None and name == "step" else part
        save_uncertainty(tmp_path, replace(KNOWN, **{name: given}), STATE)
        found = getattr(load_uncertainty(tmp_path, STATE), name)
        assert (found is None) if part is None else torch.equal(found, given)


def test_a_band_after_the_step_is_that_of_the_parameters_before_it():
    """Where the step is short: sensitivities of a wider network, at the places where theta went."""
    torch.manual_seed(0)
    network = {"width": 4, "depth": 2, "activation": "tanh"}
    options = {"dof": 1, "inertia": 1.0, "hamiltonian": "generic", "mu": None, "inputs": "cartesian"}
    own = make_dynamics(
        "hamiltonian", **options, scaling="block", network=network, integrator={"name": "rk4"}
    ).double()
    count = sum(p.numel() for p in own.parameters())
    draws = torch.randn(count, count + 2, dtype=torch.float64)
    known = Uncertainty(draws[:, :count], draws[:, -1], 2.0, {}, draws[:, :3], 1e-5 * draws[:, -2])
    start, lengths = torch.rand(3, 2, dtype=torch.float64), torch.full((3, 5), 0.1, dtype=torch.float64)
    dynamics, after = known.taken(own)
    assert after.step is None
    assert after.directions is None
    assert after.inflation == 2.0
    band = rollout_covariances(dynamics, start, lengths, after.spread)
    close(band, rollout_covariances(own, start, lengths, known.spread), 1e-3)
    assert after.before is own
    assert after.tangent[1] is known
    x = torch.rand(6, 2, dtype=torch.float64)
    close(field_columns(dynamics, after.spread)(x), field_columns(own, known.spread)(x), 1e-3)
    same, unchanged = replace(known, step=None).taken(own)
    assert same is own
    assert unchanged.factor is known.factor


def test_a_damaged_file_is_refused(tmp_path):
    save_uncertainty(tmp_path, KNOWN, STATE)
    content = bytearray((tmp_path / FILE).read_bytes())
    content[-3] ^= 1
    (tmp_path / FILE).write_bytes(content)
    with pytest.raises(UserError, match="damaged"):
        load_uncertainty(tmp_path, STATE)


@pytest.mark.parametrize(
    "wrong",
    [
        {"factor": KNOWN.factor[:1]},
        {"step": torch.zeros(3)},
        {"directions": torch.zeros(3, 1)},
        {"directions": torch.zeros(2)},
    ],
)
def test_tensors_that_do_not_fit_each_other_are_refused(wrong, tmp_path):
    save_uncertainty(tmp_path, KNOWN, STATE)
    about = read_weights(tmp_path / FILE).about
    assert about["format"] == FORMAT
    tensors = {"factor": KNOWN.factor, "offset": KNOWN.offset} | wrong
    write_weights(tmp_path / FILE, Weights(tensors, about))
    with pytest.raises(UserError, match="a square factor, steps and directions of its length"):
        load_uncertainty(tmp_path, STATE)
