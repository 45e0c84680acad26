"""The covariance as a file: it comes back as it was, belongs to its weights, and shows damage."""

from __future__ import annotations

import pytest
import torch
from helpers import close

from ahnn.checkpoints import FORMAT, Weights, write_weights
from ahnn.errors import UserError
from ahnn.uncertainty import Uncertainty, load_uncertainty, save_uncertainty
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


def test_a_damaged_file_is_refused(tmp_path):
    save_uncertainty(tmp_path, KNOWN, STATE)
    content = bytearray((tmp_path / FILE).read_bytes())
    content[-3] ^= 1
    (tmp_path / FILE).write_bytes(content)
    with pytest.raises(UserError, match="damaged"):
        load_uncertainty(tmp_path, STATE)


def test_a_factor_of_another_shape_is_refused(tmp_path):
    save_uncertainty(tmp_path, KNOWN, STATE)
    from ahnn.checkpoints import read_weights

    about = read_weights(tmp_path / FILE).about
    assert about["format"] == FORMAT
    write_weights(tmp_path / FILE, Weights({"factor": KNOWN.factor[:1], "offset": KNOWN.offset}, about))
    with pytest.raises(UserError, match="square factor"):
        load_uncertainty(tmp_path, STATE)
