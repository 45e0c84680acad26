"""Identifiability checks before measurements are generated."""

from __future__ import annotations

from ahnn.data.sensor import Sensor
from ahnn.dynamics import Dynamics, has_field
from ahnn.dynamics.derivatives import knows_velocities
from ahnn.errors import UserError


def require_identifiable(dynamics: Dynamics, sensor: Sensor, *, windows: bool) -> None:
    """Check that the measurements determine the dynamics and suit the loss.

    Position measurements determine momenta only if the kinetic energy is known: any other p(q, dq/dt) gives a
    Hamiltonian with the same positions.

    Args:
        dynamics: dynamics to be learned.
        sensor: sensor of the training data.
        windows: whether the loss compares windows of states.

    Raises:
        UserError: they do not; the message names identifiable alternatives.
    """
    if dynamics.clock:
        message = (
            "data.noise: expected forces that depend only on positions and velocities, for training on "
            f"measurements; received {dynamics.assumes}, which depend on time or controls. Train on exact "
            "states"
        )
        raise UserError(message)
    if sensor.gives_states:
        return
    received = f"received {', '.join(sensor.measurement.names)}"
    if windows:
        message = (
            f"loss: expected measured states for a loss on windows; {received}. Use recipe=measurements, and "
            "loss=shooting where the model sets another loss"
        )
        raise UserError(message)
    if not (has_field(dynamics) and knows_velocities(dynamics.field)):
        message = (
            f"data.measured: expected momenta among the measurements, or a known kinetic energy; {received} "
            f"for a {dynamics.assumes.split(',')[0]}. Use hamiltonian=mechanical or central_body"
        )
        raise UserError(message)


def require_unbiased(balance: float) -> None:
    """Check that windows of measured states are not weighted by their own noisy increments.

    A weight that depends on the noise of its own residual selects samples by their noise, and biases the fit
    for any number of samples.

    Raises:
        UserError: they are; the message names losses weighted by standard deviations.
    """
    if balance:
        message = (
            "loss.balance: expected 0 with measured states, whose noise would set the weights; received "
            f"{balance:g}. Use recipe=noisy_states or dense_states, which weight by noise, or loss.balance=0"
        )
        raise UserError(message)
