"""Construction of the evaluation setting from plugin options and a system."""

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
from ahnn.systems.drawn_states import drawn_states
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
    """Build the setting of a system from the options of `EstimatorEvaluation`.

    Args:
        system: measured system.
        steps: number of steps of the shortest trajectory.
        measurement: a measurement model, or the name of one that measures state components.
        measurement_sd: standard deviations of the noise; None for the system's default, if positions are
            measured.
        start_sd: standard deviations of the initial state (`state_deviations`); None for the system's
            default.
        bias_sd: standard deviations of estimated measurement biases; None: no biases.
        bias_memory: time constants of the biases; None for constant biases.
        cadence: steps between two measurements.
        times: measurement times, as an alternative to a cadence.

    Raises:
        UserError: no measurement falls within a trajectory, or an option is incompatible with the system.
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
        message = (
            f"cadence: expected at most {steps}, the number of steps of a trajectory; received {cadence}"
        )
        raise UserError(message)
    return tuple(range(cadence, steps + 1, cadence))


def _samples(times: Sequence[float], dt: float, steps: int) -> tuple[int, ...]:
    """Return the sample indices at given times."""
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
    """Evaluate a measurement model on an initial state as a check."""
    x = drawn_states(system, 1, torch.Generator().manual_seed(0))
    mass = getattr(measurement, "mass", system.inertia)
    if mass != system.inertia:
        message = (
            f"measurement: expected {type(measurement).__name__} with mass={system.space.mass:g}, the mass "
            f"of the system, since it reads momenta; received mass={mass:g}"
        )
        raise UserError(message)
    expected = (1, len(measurement.names))
    try:
        shape = tuple(measurement(x, time).shape)
    except (RuntimeError, IndexError, ValueError) as error:
        message = (
            f"measurement: expected a model for states with {x.shape[-1]} components; "
            f"{type(measurement).__name__} failed: {error}"
        )
        raise UserError(message) from error
    if shape != expected:
        message = f"measurement: expected measurements {expected}; received {shape}"
        raise UserError(message)


def require_measurement(measurement: Any) -> None:
    """Raise UserError for anything but a measurement model."""
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
            "measurement: expected a measurement model with names, units and __call__; "
            f"{type(measurement).__name__} has no {', '.join(missing)}"
        )
        raise UserError(message)


def near_system(truth: System | None, beside: System | None, space: Space) -> System:
    """Return the system that provides default noise and initial states for filter settings.

    Args:
        truth: known equations of the data, or None.
        beside: a similar system for data with unknown equations.
        space: description of the state components.

    Raises:
        UserError: neither or both systems are given, or the units of `beside` and `space` differ.
    """
    if beside is not None and (truth is not None or beside.units != space.units):
        received = f"the equations of {space.name}" if truth is not None else str(space.units)
        message = f"beside: expected data without known equations, in {beside.units}; received {received}"
        raise UserError(message)
    if (system := truth or beside) is None:
        message = (
            f"system: expected a system with known equations; received data for {space.name}. Use python -m "
            "ahnn.assimilate, which filters measurements without known equations"
        )
        raise UserError(message)
    return system
