"""Jacobians of a generic Hamiltonian's field, and of Runge-Kutta steps along it, in closed form.

In the coordinates of the network, z = (x - shift) / scale, the field is dz/dt = c (g_p, -g_q) with g = grad N
and c = unit / (scale_q scale_p). Runge-Kutta steps look the same in x and z.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from ahnn.cores import each, slices
from ahnn.dynamics.activations import Kernels
from ahnn.dynamics.gradients import Layers, Record, recorded_gradient
from ahnn.dynamics.hamiltonians import GenericHamiltonian
from ahnn.dynamics.inputs import Cartesian
from ahnn.dynamics.networks import Perceptron
from ahnn.dynamics.rows import Stage, layers_at, reversed_rows, write_rows
from ahnn.dynamics.written_out import combined, moved
from ahnn.integrators.base import column
from ahnn.integrators.tableaus import ButcherTableau
from ahnn.types import TimeStep

PARTS, LARGEST = 4, 1000
"""Parts that samples are divided into, for several cores, and the most samples in one, for their caches."""


def has_rows(field: nn.Module) -> bool:
    """Return whether the rows of this field are known in closed form."""
    return (
        isinstance(field, GenericHamiltonian)
        and isinstance(field.positions, Cartesian)
        and isinstance(field.network, Perceptron)
        and field.network.activation.kernels is not None
        and len(list(field.parameters())) == len(list(field.network.parameters()))
    )


class Scaled(NamedTuple):
    """The field in the coordinates of its network, at parameters of its own.

    Attributes:
        layers: hidden layers, and E so that dz/dt = delta_1 E.
        c: (n,).
        shift, scale: of the coordinates, (D,).
        kernels: of the activation.
    """

    layers: Layers
    c: Tensor
    shift: Tensor
    scale: Tensor
    kernels: Kernels

    @classmethod
    def of(cls, field: GenericHamiltonian, theta: Tensor) -> Scaled:
        """Return the field at the parameters theta, (P,), in their precision."""
        network = field.network
        assert isinstance(network, Perceptron)
        layers = layers_at(network, theta)
        assert isinstance(field.positions, Cartesian)
        maps = (field.positions.affine, field.momenta.affine)
        scale = torch.cat([m.scale for m in maps]).to(theta)
        shift = torch.cat([m.shift for m in maps]).to(theta)
        of_q, of_p = scale.chunk(2)
        c = field.unit.to(theta) / (of_q * of_p)
        first_q, first_p = layers.weights[0].chunk(2, dim=1)
        layers = layers._replace(leave=torch.cat((c * first_p, -c * first_q), dim=1))
        kernels = network.activation.kernels
        assert kernels is not None
        return cls(layers, c, shift, scale, kernels)

    def seen(self, x: Tensor) -> Tensor:
        """Return z, shape (B, D), by columns, as fields come."""
        return ((x - self.shift) / self.scale).T.contiguous().T

    def recorded(self, z: Tensor) -> tuple[Tensor, list[Record]]:
        """Return dz/dt, shape (B, D), with what the reverse needs."""
        return recorded_gradient(z, self.layers, self.kernels)

    def reverse(self, v: Tensor, records: list[Record]) -> tuple[Stage, Tensor]:
        """Return the reverse of dz/dt for the cotangents v, (B, R, D), and v . d(dz/dt)/dz."""
        of_q, of_p = v.chunk(2, dim=-1)
        turned = torch.cat((-self.c * of_p, self.c * of_q), dim=-1)
        return reversed_rows(turned, records, self.layers.weights)


def field_rows(field: GenericHamiltonian, theta: Tensor, x: Tensor, factors: Tensor) -> Tensor:
    """Return factors df/dtheta, shape (B, D, P), of the field f at the states x; both are (B, D)."""
    at = Scaled.of(field, theta)
    out = x.new_empty(*x.shape, len(theta))

    def write(part: slice) -> None:
        _, records = at.recorded(at.seen(x[part]))
        stage, _ = at.reverse(torch.diag_embed(factors[part] * at.scale), records)
        write_rows([stage], out[part])

    each(write, _parts(x), x.device)
    return out


def increment_rows(
    field: GenericHamiltonian, tableau: ButcherTableau, theta: Tensor, x: Tensor, dt: TimeStep
) -> tuple[Tensor, Tensor]:
    """Return d(increment)/dtheta, (B, D, P), and d(increment)/dx, (B, D, D), of a step from x, (B, D)."""
    at = Scaled.of(field, theta)
    out = x.new_empty(*x.shape, len(theta))

    def of_state(part: slice) -> Tensor:
        h = dt[part] if isinstance(dt, Tensor) and dt.ndim else dt
        stages, by_state = _reversed_step(at, tableau, x[part], column(h))
        write_rows(stages, out[part])
        return by_state

    return out, torch.cat(each(of_state, _parts(x), x.device))


def _parts(x: Tensor) -> list[slice]:
    """Return the parts of the samples x."""
    return slices(len(x), min(LARGEST, max(1, -(-len(x) // PARTS))), x.device)


def _reversed_step(at: Scaled, tableau: ButcherTableau, x: Tensor, h: TimeStep) -> tuple[list[Stage], Tensor]:
    """Return the stages of a step, reversed for each component of its increment, and d(increment)/dx."""
    z, slopes, records = at.seen(x), [], []
    for row in ((), *tableau.a):
        slope, record = at.recorded(moved(z, row, slopes, h))
        slopes.append(slope)
        records.append(record)
    h = h.unsqueeze(-1) if isinstance(h, Tensor) and h.ndim else h
    seed = torch.diag(at.scale).expand(len(x), -1, -1)
    later, stages = [seed], []  # cotangents of the increment, then those of the stages from the last
    for i in reversed(range(len(records))):
        weights = (tableau.b[i], *(row[i] for row in reversed(tableau.a[i:])))
        if not any(weights):
            later.append(torch.zeros_like(seed))
            continue
        stage, moved_by = at.reverse(combined(weights, later, h), records[i])
        stages.append(stage)
        later.append(moved_by)
    return stages, torch.stack(later[1:]).sum(0) / at.scale
