"""Process noise of a filter from the plugin option `process_noise`."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal, cast

import torch
from torch import Tensor

from ahnn.arguments import Positive, Within, check_arguments, checked
from ahnn.deviations import require_squares
from ahnn.dynamics import Dynamics
from ahnn.errors import UserError
from ahnn.estimation.force_error import ForceError
from ahnn.estimation.force_error_fit import fitted_force_error
from ahnn.estimation.parameter_error import ParameterError
from ahnn.estimation.process_noise import fitted_process_noise
from ahnn.estimation.scenario import Problem, Setting
from ahnn.estimation.trial import Filter
from ahnn.evaluation import Case
from ahnn.evaluation.estimators.learned_parameters import ENOUGH, parameters_as_states, simulated_filter
from ahnn.systems import System
from ahnn.types import Flow, Space
from ahnn.uncertainty import Uncertainty, growth
from ahnn.uncertainty.directions import MOST, Chosen, filtered_directions

log = logging.getLogger(__name__)

FITTED_ON, FORCE_FITTED_ON = 20, 100
"""Number of validation trajectories for fits of the scale of Q and of a force error."""

Deviation = Annotated[float, Within(0)]
Noise = tuple[Tensor, ForceError | ParameterError | None]
"""Q of one step, (D, D), and an additional error of the force or of the parameters."""


@checked
@dataclass(frozen=True)
class ForceOptions:
    """Options of a relative force error with memory; None values are fitted to validation data.

    Attributes:
        size: standard deviation, as a fraction of the force.
        memory: time constant, in the unit of the system.
    """

    size: Positive | None = None
    memory: Positive | None = None

    def added(self, dof: int) -> int:
        """Return the number of additional state components."""
        return dof


class ParameterOptions:
    """Option of learned parameters as states, with their covariance as prior."""

    def added(self, dof: int) -> int:
        """Return the maximum number of additional state components."""
        return MOST


NoiseOption = Literal["fitted"] | tuple[Deviation, Deviation] | ForceOptions | ParameterOptions
GivenNoise = (
    Literal["fitted", "force_error", "parameter_error"] | tuple[Deviation, Deviation] | dict[str, Any]
)


def noise_option(given: GivenNoise) -> NoiseOption:
    """Parse the option; raises UserError for unknown or wrong keys of a force error."""
    if isinstance(given, dict):
        check_arguments("process_noise", ForceOptions, given)
        return ForceOptions(**given)
    if given == "parameter_error":
        return ParameterOptions()
    return ForceOptions() if given == "force_error" else given


def without_parameters(option: NoiseOption) -> NoiseOption:
    """Return the option for a flow without learned parameters: a force error instead."""
    return ForceOptions() if isinstance(option, ParameterOptions) else option


def given_noise(
    option: NoiseOption,
    space: Space,
    growth: Callable[[Tensor], Tensor] | None = None,
    flow: Flow | None = None,
    known: Uncertainty | None = None,
) -> Noise | None:
    """Return Q of one step and the additional error; None if they must be fitted to data.

    Args:
        option: see `noise_option`.
        space: description of the state components.
        growth: factor (...) on the error at states (..., D); None for 1 everywhere.
        flow: process model.
        known: covariance of the parameters of `flow`, if available.

    Raises:
        UserError: the training did not save the least observable parameters.
    """
    nothing = torch.zeros(2 * space.dof, 2 * space.dof, dtype=torch.float64)
    if isinstance(option, ParameterOptions) and known is not None:
        return nothing, online_parameters(flow, known, growth)
    if isinstance(option, ForceOptions):
        if option.size is None or option.memory is None:
            return None
        return nothing, ForceError(option.size, option.memory, space.factor, growth)
    if isinstance(option, str | ParameterOptions):
        return None
    return given_covariance(option, space), None


def online_parameters(
    flow: Flow | None, uncertainty: Uncertainty, growth: Callable[[Tensor], Tensor] | None
) -> ParameterError:
    """Build learned parameters as states in the directions saved by training; UserError if there are none."""
    dynamics, known = uncertainty.tangent or (cast(Dynamics, flow), uncertainty)
    if known.directions is None:
        message = (
            "process_noise: expected a run that stored its least observable parameters; received one trained "
            "by an earlier version, or not on measurements. Train again, or use plugins=ukf"
        )
        raise UserError(message)
    return parameters_as_states(dynamics, Chosen(known.directions, 0.0), growth)


def given_covariance(deviations: tuple[float, float], space: Space) -> Tensor:
    """Return Q, (D, D), from standard deviations of positions and velocities."""
    position, velocity = deviations
    values = torch.tensor([position, velocity], dtype=torch.float64).repeat_interleave(space.dof)
    values = values * space.scales
    require_squares(values[values > 0], "process_noise")
    return torch.diag(values**2)


def with_process_noise(
    option: NoiseOption,
    plain: Filter,
    case: Case,
    setting: Setting,
    arcs: Callable[[int], Problem],
    rate: float | None = None,
) -> tuple[Filter, dict[str, Any]]:
    """Return a filter with the process noise of its model, and the noise's origin as plain values.

    If parameters with unknown covariance are requested, a force error replaces them, with a warning.

    Args:
        option: see `noise_option`.
        plain: filter without process noise.
        case: evaluated case.
        setting: measurement settings and P0.
        arcs: function that returns a given number of full validation trajectories, to choose a scale.
        rate: growth rate of a force error with the square of novelty - 1; None: no growth.

    Raises:
        UserError: a rate is given, but the model contains no representative training states.
    """
    if isinstance(option, ParameterOptions) and case.uncertainty is None:
        log.warning(
            "process_noise: parameter_error needs a parameter covariance, which training stores if the model "
            "fits its measurements; there is none, so force_error is used"
        )
        option = ForceOptions()
    if isinstance(option, ParameterOptions):
        assert case.uncertainty is not None
        learned, watched = cast(Dynamics, case.flow), simulated_filter(case, setting)
        dynamics, known = case.uncertainty.tangent or (learned, case.uncertainty)
        chosen = filtered_directions(dynamics, known.spread, watched, MOST, ENOUGH, learned)
        error = parameters_as_states(dynamics, chosen, grown(case.novelty, rate))
        about = {"from": "parameter_error", "directions": error.added, "left_out": error.left_out}
        about["novelty"] = rate
        return plain._replace(force_error=error), about
    if isinstance(option, ForceOptions):
        given = {"size": option.size, "memory": option.memory, "growth": grown(case.novelty, rate)}
        tried, inertia = arcs(FORCE_FITTED_ON), case.space.factor
        fit = fitted_force_error(plain, setting, tried, case.validation, inertia, **given)
        estimate = {"size": float(fit.error.size), "memory": float(fit.error.memory)}
        about = {"from": "force_error", **estimate, "scale": fit.scale, "nees_of_scales": list(fit.nees)}
        about["novelty"] = rate
        # Zero variance would make every member fail.
        return plain._replace(force_error=fit.error if estimate["size"] > 0.0 else None), about
    if isinstance(option, str):
        fitted = fitted_process_noise(plain, setting, arcs(FITTED_ON), case.validation)
        q = fitted.covariance
        about = {"from": "fitted", "scale": fitted.scale, "nees_of_scales": list(fitted.nees)}
    else:
        q = given_covariance(option, case.space)
        about = {"from": "given"}
    return plain._replace(process_noise=q), {**about, "step_sd": q.diagonal().sqrt().tolist()}


def grown(
    novelty: Callable[[Tensor], Tensor] | None, rate: float | None
) -> Callable[[Tensor], Tensor] | None:
    """Return the growth factor of a force error as a function of states; UserError for unknown novelty."""
    if rate is None:
        return None
    if novelty is None:
        message = (
            "novelty: expected weights that describe their training data; received weights without a "
            "description"
        )
        raise UserError(message)
    return lambda x: growth(novelty(x), rate)


def require_truth(option: NoiseOption, truth: System | None) -> None:
    """Raise UserError if process noise is to be fitted to true states, which are unknown."""
    if truth is None:
        received = {"ForceOptions": "force_error", "ParameterOptions": "no parameter covariance"}
        message = (
            "process_noise: for data without known true states, expected standard deviations or (after "
            "training on measurements) parameter_error; received "
            f"{received.get(type(option).__name__, option)}. Use plugins=ukf_parameter_error or "
            "process_noise=[POSITION,VELOCITY] of the plugin"
        )
        raise UserError(message)
