"""What measurements can tell of dynamics, asked before any are generated."""

from __future__ import annotations

from ahnn.data.sensor import Sensor
from ahnn.dynamics import Dynamics, has_field
from ahnn.dynamics.derivatives import knows_velocities
from ahnn.errors import UserError


def require_identifiable(dynamics: Dynamics, sensor: Sensor, *, windows: bool) -> None:
    """Refuse dynamics or a loss that the measurements do not determine.

    From positions alone only a known kinetic energy says what the momenta are: any other p(q, dq/dt) gives a
    Hamiltonian with the same positions.

    Args:
        dynamics: what is to be learned.
        sensor: what training sees.
        windows: whether the loss compares windows of states.

    Raises:
        UserError: names what can be learned instead.
    """
    if dynamics.clock:
        message = (
            "data.noise: expected forces of positions and velocities alone for training on measurements; "
            f"received {dynamics.assumes}, which depend on time or controls. Train on exact states"
        )
        raise UserError(message)
    if sensor.gives_states:
        return
    received = f"received {', '.join(sensor.measurement.names)}"
    if windows:
        message = f"loss: expected measured states for windows of them; {received}. Use recipe=measurements"
        raise UserError(message)
    if not (has_field(dynamics) and knows_velocities(dynamics.field)):
        message = (
            f"data.measured: expected momenta among the measurements, or a known kinetic energy; {received} "
            f"for a {dynamics.assumes.split(',')[0]}. Use hamiltonian=mechanical or central_body"
        )
        raise UserError(message)


def require_unbiased(balance: float) -> None:
    """Refuse windows of measured states that count relative to their own increments, which hold their noise.

    A weight that falls with the noise of the residual it belongs to favours samples by their noise: the fit
    is biased however many there are.

    Raises:
        UserError: names the losses that weigh by standard deviations.
    """
    if balance:
        message = (
            "loss.balance: expected 0 with measured states, whose noise would set the weights; received "
            f"{balance:g}. Use recipe=noisy_states or dense_states, which weigh by noise, or loss.balance=0"
        )
        raise UserError(message)
