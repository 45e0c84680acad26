"""Process noise in units of what the covariance of the learned parameters says of the force."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import pytest
import torch
from oscillators import Swing
from test_ukf_evaluation import SPRING, STIFFER, make_case, run

from ahnn.errors import UserError
from ahnn.evaluation import Case
from ahnn.uncertainty import Uncertainty

__all__ = ["make_case"]


def test_a_parameter_error_is_in_units_of_what_the_covariance_says(make_case: Callable[..., Case]) -> None:
    deviation = 0.01  # of a stiffness that is off by 0.02
    known = Uncertainty(deviation * torch.eye(2, 1).double(), torch.zeros(2).double(), 1.0, {})
    case = dataclasses.replace(make_case(SPRING, Swing(STIFFER.stiffness, 0.0)), uncertainty=known)
    findings = run(case, group="ukf_parameter_error")
    noise = findings.numbers["process_noise"]
    assert noise["from"] == "parameter_error"
    assert noise["size"] / noise["scale"] ** 0.5 == pytest.approx(2.0, rel=0.02)
    assert findings.numbers["filters"]["ukf"]["model"]["perturbed"]["status"]["OK"] == 6
    relative = run(case, "process_noise=force_error").numbers["process_noise"]
    assert noise["size"] * deviation / STIFFER.stiffness == pytest.approx(relative["size"], rel=0.01)
    with pytest.raises(UserError, match="expected weights with a covariance"):
        run(dataclasses.replace(case, uncertainty=None), group="ukf_parameter_error")
