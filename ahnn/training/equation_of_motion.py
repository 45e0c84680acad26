"""Differential equation of the measured quantities, compared with samples without a solver."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics, HasField, has_field
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.dynamics.energies import Quadratic
from ahnn.dynamics.hamiltonians import SeparableHamiltonian
from ahnn.errors import UserError
from ahnn.measurements import Instrument, Position, State
from ahnn.types import SeparableField


class Motion(NamedTuple):
    """Equation of motion d^k y/dt^k = f(y) of measured quantities y.

    Attributes:
        order: order k, 1 for states and 2 for positions.
        kinds: number of kinds of quantities in y: 2 for positions and momenta, 1 for positions.
        right: field of the dynamics -> f, which maps (..., M) to (..., M).
        rows: (theta, y) -> df/dtheta, (..., L, P), of the last L components, which depend on parameters.
    """

    order: int
    kinds: int
    right: Callable[[Any], Callable[[Tensor], Tensor]]
    rows: Callable[[Tensor, Tensor], Tensor]


def equation_of_motion(dynamics: Dynamics, instrument: Instrument) -> Motion:
    """Build the equation of measured states, or of positions if p^2 / 2m is known.

    Raises:
        UserError: other measurements, or dynamics whose field does not determine their motion.
    """
    measurement = instrument.measurement
    if has_field(dynamics) and isinstance(measurement, State):
        return Motion(1, 2, lambda field: field, field_jacobian(dynamics))
    if (
        has_field(dynamics)
        and isinstance(measurement, Position)
        and isinstance(dynamics.field, SeparableHamiltonian)
        and isinstance(dynamics.field.kinetic, Quadratic)
    ):
        return _of_positions(dynamics)
    message = (
        "loss.stages: weak and relative expect dynamics with a field and measured states, or positions "
        f"with a known kinetic energy; received {type(measurement).__name__} and {type(dynamics).__name__}. "
        "Begin with segments, such as [[4, 0.5], [whole, 1.0]]"
    )
    raise UserError(message)


def _of_positions(dynamics: HasField) -> Motion:
    """Return d^2 q/dt^2 = -V'(q) / m."""
    rows, known = field_jacobian(dynamics), cast(SeparableHamiltonian, dynamics.field)

    def right(field: SeparableField) -> Callable[[Tensor], Tensor]:
        return lambda q: field.velocity(field.force(q))

    def of_parameters(theta: Tensor, q: Tensor) -> Tensor:
        return known.velocity(rows(theta, torch.cat((q, torch.zeros_like(q)), -1)))  # `velocity` is linear

    return Motion(2, 1, right, of_parameters)
