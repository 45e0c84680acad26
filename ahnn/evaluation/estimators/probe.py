"""Trial step of a filter for a constant state, to check before training that float64 precision suffices."""

from __future__ import annotations

import torch

from ahnn.errors import UserError
from ahnn.estimation.belief import Status
from ahnn.estimation.estimator import Estimator
from ahnn.estimation.force_error import ForceError
from ahnn.estimation.scenario import Problem, Setting
from ahnn.estimation.trial import Filter, assimilate
from ahnn.evaluation.estimators.noise_options import NoiseOption, given_noise
from ahnn.systems import System
from ahnn.systems.drawn_states import drawn_states
from ahnn.types import TimeStep


@torch.no_grad()
def require_possible(
    setting: Setting,
    system: System,
    option: NoiseOption,
    estimator: Estimator,
) -> None:
    """Check that a filter does not fail in its first step.

    Args:
        setting: measurement settings and start.
        system: system from which a state is drawn.
        option: process noise option; ignored if fitted to data.
        estimator: estimator with its constants.

    Raises:
        UserError: the filter fails, or a matrix is not a covariance.
    """
    x = drawn_states(system, 1, torch.Generator().manual_seed(0))
    nothing = torch.zeros(x.shape[-1], x.shape[-1], dtype=torch.float64)
    known = given_noise(option, system.space) if not isinstance(option, str) else None
    q, error = (nothing, None) if known is None else known
    error = error if isinstance(error, ForceError) else None
    still = Filter("still", _still, q, setting.measurement_noise, estimator, error)
    y = setting.measurement(x, system.dt).unsqueeze(1)
    try:
        status = int(assimilate(still, setting, Problem(x.unsqueeze(1), x, y, system.dt)).status)
        reason = "" if status == Status.OK else f"is {Status(status).name} after one measurement"
    except ValueError as error:
        reason = f"has no covariance ({error})"
    if reason:
        bias = "" if setting.sensor_error is None else "bias_sd, "
        constants = "".join(f", {name}" for name in estimator.about if name != "gate")
        message = (
            f"measurement_sd, {bias}start_sd, process_noise{constants}: expected numbers whose squares "
            f"are representable in float64; received a filter that {reason}: measurement_sd "
            f"{setting.measurement_sd.tolist()}, start_sd {setting.start_sd.tolist()}, {estimator.about}"
        )
        raise UserError(message)


def _still(x: torch.Tensor, dt: TimeStep) -> torch.Tensor:  # noqa: ARG001
    return x
