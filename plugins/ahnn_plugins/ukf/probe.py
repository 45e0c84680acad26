"""One step of a filter that stands still: whether float64 holds its numbers, before any training."""

from __future__ import annotations

import torch

from ahnn.errors import UserError
from ahnn.estimation.belief import Status
from ahnn.estimation.gate import Gate
from ahnn.estimation.scenario import Problem, Setting
from ahnn.systems import System
from ahnn.types import TimeStep
from ahnn_plugins.ukf.assimilation import Filter, assimilate
from ahnn_plugins.ukf.force_error import ForceError
from ahnn_plugins.ukf.noise_options import NoiseOption, given_noise
from ahnn_plugins.ukf.types import Form, UnscentedParameters


@torch.no_grad()
def require_possible(
    setting: Setting,
    system: System,
    option: NoiseOption,
    parameters: UnscentedParameters,
    form: Form,
    gate: Gate | None,
) -> None:
    """Refuse numbers with which a filter fails in its first step already.

    Args:
        setting: measurements and start.
        system: gives a state.
        option: process noise; one that is fitted to data is left out.
        parameters: of the sigma points.
        form: of the covariances.
        gate: of the measurements.

    Raises:
        UserError: a filter whose status is not OK, or a covariance that is none.
    """
    x = system.initial_states(1, torch.Generator().manual_seed(0))
    nothing = torch.zeros(x.shape[-1], x.shape[-1], dtype=torch.float64)
    known = given_noise(option, system.space) if not isinstance(option, str) else None
    q, error = (nothing, None) if known is None else known
    error = error if isinstance(error, ForceError) else None
    constants = setting.measurement_noise, parameters, form, gate
    still = Filter("still", _still, q, *constants, force_error=error)
    y = setting.measurement(x, system.dt).unsqueeze(1)
    try:
        status = int(assimilate(still, setting, Problem(x.unsqueeze(1), x, y, system.dt)).status)
        reason = "" if status == Status.OK else f"is {Status(status).name} after one measurement"
    except ValueError as error:
        reason = f"has no covariance ({error})"
    if reason:
        message = (
            "measurement_sd, start_sd, process_noise, alpha: expected numbers that float64 holds with their "
            f"squares; received a filter that {reason}: measurement_sd "
            f"{setting.measurement_sd.tolist()}, start_sd {setting.start_sd.tolist()}, {parameters}"
        )
        raise UserError(message)


def _still(x: torch.Tensor, dt: TimeStep) -> torch.Tensor:  # noqa: ARG001
    return x
