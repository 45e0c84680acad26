"""From the options of the plugin and a system to the setting that all models of an evaluation share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import torch

from ahnn.arguments import Count, Positive, checked
from ahnn.deviations import state_deviations
from ahnn.errors import UserError
from ahnn.estimation.scenario import Setting
from ahnn.estimation.sensor_error import SensorError
from ahnn.measurements import Biases, Measurement, noise_deviations, reading
from ahnn.systems import System
from ahnn.types import Space


@checked
def make_setting(
    system: System,
    steps: int,
    *,
    measurement: Measurement | Literal["position", "state"],
    measurement_sd: Positive | list[Positive] | None,
    start_sd: list[Positive] | None,
    bias_sd: float | list[float] | None = None,
    bias_memory: float | list[float] | None = None,
    cadence: Count,
    times: Sequence[float] | None,
) -> Setting:
    """Return the setting of a system from the options of `UKFEvaluation`.

    Args:
        system: what is measured.
        steps: of the shortest trajectory.
        measurement: a model, or the name of one that reads the state itself.
        measurement_sd: standard deviations of its noise; None takes the system's own for positions.
        start_sd: of the initial state (`state_deviations`); None takes the system's own.
        bias_sd: standard deviations of biases of the measurements, which are estimated; None for none.
        bias_memory: their time constants; None for constant ones.
        cadence: steps between two measurements.
        times: of the measurements, in place of a cadence.

    Raises:
        UserError: no measurement falls within a trajectory, or an option does not fit the system.
    """
    updates = _cadence(cadence, steps) if times is None else _samples(times, system.dt, steps)
    model = reading(measurement, system.space) if isinstance(measurement, str) else measurement
    default = system.noise.measurement if measurement == "position" else None
    given = default if measurement_sd is None else measurement_sd
    sd = noise_deviations(model, given, "measurement_sd")
    _try(model, system, updates[0] * system.dt)
    start = system.deviations() if start_sd is None else state_deviations(start_sd, system.space, "start_sd")
    biases = Biases.of(model, bias_sd, bias_memory, "measurement.")
    return Setting(model, sd, start, updates, SensorError.of({"": biases}))


def _cadence(cadence: int, steps: int) -> tuple[int, ...]:
    if cadence > steps:
        message = f"cadence: expected at most {steps}, the steps of a trajectory; received {cadence}"
        raise UserError(message)
    return tuple(range(cadence, steps + 1, cadence))


def _samples(times: Sequence[float], dt: float, steps: int) -> tuple[int, ...]:
    """Return the samples at given times."""
    samples = [round(t / dt) if math.isfinite(t) else -1 for t in times]
    there = all(abs(k * dt - t) <= 1e-6 * dt and 1 <= k <= steps for k, t in zip(samples, times, strict=True))
    if not samples or not there or samples != sorted(set(samples)):
        message = (
            f"times: expected increasing multiples of dt = {dt:g}, from {dt:g} to "
            f"{steps * dt:g}; received {list(times)}"
        )
        raise UserError(message)
    return tuple(samples)


def _try(measurement: Any, system: System, time: float) -> None:
    """Try a measurement model on an initial state."""
    x = system.initial_states(1, torch.Generator().manual_seed(0))
    mass = getattr(measurement, "mass", system.inertia)
    if mass != system.inertia:
        message = (
            f"measurement: expected {type(measurement).__name__} with mass={system.space.mass:g}, "
            f"that of the system, whose momenta it reads; received mass={mass:g}"
        )
        raise UserError(message)
    expected = (1, len(measurement.names))
    try:
        shape = tuple(measurement(x, time).shape)
    except (RuntimeError, IndexError, ValueError) as error:
        message = (
            f"measurement: expected a model of states with {x.shape[-1]} components; "
            f"{type(measurement).__name__} failed: {error}"
        )
        raise UserError(message) from error
    if shape != expected:
        message = f"measurement: expected measurements {expected}; received {shape}"
        raise UserError(message)


def require_measurement(measurement: Any) -> None:
    """Refuse what is no measurement; raises UserError."""
    if isinstance(measurement, str):
        return
    if isinstance(measurement, dict):
        message = (
            "measurement: expected position, state or a node with _target_; received keys "
            f"{', '.join(measurement)}"
        )
        raise UserError(message)
    missing = [name for name in ("names", "units", "__call__") if not hasattr(measurement, name)]
    if missing:
        message = (
            "measurement: expected a measurement model with names, units, __call__; "
            f"{type(measurement).__name__} has no {', '.join(missing)}"
        )
        raise UserError(message)


def near_system(truth: System | None, beside: System | None, space: Space) -> System:
    """Return the system whose default noise and initial states the settings of a filter are made of.

    Args:
        truth: the equations of the data, if they are known.
        beside: a system that is near data whose equations are not known.
        space: what the numbers of the data mean.

    Raises:
        UserError: neither is there, or both, or the second has other units.
    """
    if beside is not None and (truth is not None or beside.units != space.units):
        received = f"those of {space.name}" if truth is not None else str(space.units)
        message = f"beside: expected data without known equations, in {beside.units}; received {received}"
        raise UserError(message)
    if (system := truth or beside) is None:
        message = (
            f"system: expected one whose equations are known; received data of {space.name}. "
            "Use python -m ahnn.assimilate, which filters measurements and needs none"
        )
        raise UserError(message)
    return system
