"""Learned Hamiltonian flows in C, for the few states of a single filter.

For a small network and 13 sigma points, torch operations take more time for overhead than for arithmetic,
even when they are recorded.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.compiled_libraries import NUMBER as N
from ahnn.compiled_libraries import POINTER as P
from ahnn.compiled_libraries import REAL as R
from ahnn.compiled_libraries import CompiledFlow, compiled_library, numbers_alone, plain
from ahnn.dynamics.energies import CentralBody, NetworkEnergy, Quadratic
from ahnn.dynamics.fields import HamiltonianDynamics
from ahnn.dynamics.hamiltonians import GenericHamiltonian, SeparableHamiltonian
from ahnn.dynamics.inputs import Cartesian, InputMap, Isotropic, Radial
from ahnn.dynamics.native import KNOWN, table
from ahnn.dynamics.networks import Perceptron
from ahnn.dynamics.transition import transition
from ahnn.integrators import ExplicitRungeKutta, SymmetricComposition
from ahnn.types import TimeStep

MAPS = Cartesian, Isotropic, Radial
"""Input maps in the order of their numbers in the C library."""
MEMBERS, ROWS = 16, 4
"""Number of states processed together, and rows per matrix tile; the C library defines the same numbers."""


class EnergyConstants(ctypes.Structure):
    """Constants of an energy, laid out as in learned_flow.c."""

    _fields_ = (
        *((name, N) for name in ("map", "mapped", "straight", "inputs", "width", "depth", "activation")),
        *((name, P) for name in ("up", "down", "bias", "last", "shift", "scale")),
        *((name, R) for name in ("offset", "unit", "falloff", "nearest", "middle", "spread")),
    )


class MotionConstants(ctypes.Structure):
    """Constants of a Hamiltonian and its integrator, laid out as in learned_flow.c."""

    _fields_ = (
        *((name, N) for name in ("dof", "stages", "kicks")),
        *((name, P) for name in ("whole", "kinetic", "potential", "mass", "table")),
        ("central", R),
    )


@cache
def library() -> ctypes.CDLL | None:
    """Return the C library, or None without a C compiler."""
    source = Path(__file__).with_name("learned_flow.c")
    return compiled_library(source, {"ahnn_learned_flow": (P, N, P, R, P)}, "the learned flow", vectors=True)


class LearnedFlow:
    """Flow of learned Hamiltonian dynamics in C, equal to `flow` up to rounding.

    Its parameters are those at construction. Calls with gradients or separate step lengths use `flow`.

    Args:
        flow: the dynamics.
        motion: their constants.
        owners: objects that own the memory of the constants.
    """

    def __init__(self, flow: HamiltonianDynamics, motion: MotionConstants, owners: tuple[Any, ...]) -> None:
        self.flow, self.motion, self.owners = flow, motion, owners

    def __reduce__(self) -> tuple[Any, ...]:
        """Rebuild copies from the dynamics, since addresses cannot be copied."""
        return _again, (self.flow,)

    def transition(self, x: Tensor, dt: TimeStep) -> tuple[Tensor, Tensor]:
        """Return the states (B, D) after dt, and the state transitions (B, D, D)."""
        return transition(self.flow, x, dt)

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (B, D) after dt."""
        single = not (isinstance(dt, Tensor) and dt.ndim)
        if not single or not numbers_alone(x, dt) or x.shape[1] != 2 * self.motion.dof:
            return self.flow(x, dt)
        x, found = x.contiguous(), library()
        out = torch.empty_like(x)
        assert found is not None
        about = ctypes.addressof(self.motion)
        if found.ahnn_learned_flow(about, len(x), x.data_ptr(), float(dt), out.data_ptr()):
            message = f"flow: not enough memory for {len(x)} states"
            raise MemoryError(message)
        return out

    def as_compiled(self) -> CompiledFlow | None:
        """Return the flow for loops in C."""
        found = library()
        assert found is not None
        function = ctypes.cast(found.ahnn_learned_flow, P).value
        assert function is not None
        return CompiledFlow(function, ctypes.addressof(self.motion), (found, self))


def _again(flow: HamiltonianDynamics) -> LearnedFlow | HamiltonianDynamics:
    """Return the flow of copied dynamics."""
    return learned_flow(flow) or flow


@torch.no_grad()
def learned_flow(flow: Any) -> LearnedFlow | None:
    """Return a flow in C of the dynamics; None if the library is unavailable or does not support them."""
    if type(flow) is not HamiltonianDynamics or flow.clock:
        return None
    if not all(plain(part.data, torch.float64) for part in (*flow.parameters(), *flow.buffers())):
        return None
    dof: int = getattr(flow, "spec", {}).get("dof", 0)
    energies, constants = _energies(flow.field, dof) if dof else ({}, {})
    method = flow.integrator
    if not energies or not isinstance(method, ExplicitRungeKutta | SymmetricComposition) or library() is None:
        return None
    kicks = 0
    if isinstance(method, ExplicitRungeKutta):
        weights = table(method.tableau, torch.float64)
    else:
        kicks = len(method.weights[1])
        weights = torch.tensor([*method.weights[0], *method.weights[1]], dtype=torch.float64)
    mass = torch.as_tensor(constants.get("mass", 1.0), dtype=torch.float64).expand(dof).contiguous()
    own = {name: ctypes.addressof(energy.constants) for name, energy in energies.items()}
    motion = MotionConstants(
        dof=dof,
        stages=max(weights.shape[-1] if not kicks else 0, 1),
        kicks=kicks,
        mass=mass.data_ptr(),
        table=weights.data_ptr(),
        central=float(constants.get("central", 0.0)),
        **own,
    )
    return LearnedFlow(flow, motion, (energies, mass, weights))


class PackedEnergy(NamedTuple):
    """Constants of an energy, and the tensors that own their memory."""

    constants: EnergyConstants
    owners: tuple[Tensor, ...]


def _energies(field: Any, dof: int) -> tuple[dict[str, PackedEnergy], dict[str, Any]]:
    """Return the packed energies of a field by name, empty if unsupported, and its mass and attraction."""
    if type(field) is GenericHamiltonian:
        packed = _packed(field.network, dof, field.positions, field.momenta, float(field.unit))
        return ({"whole": packed} if packed else {}), {}
    if type(field) is not SeparableHamiltonian:
        return {}, {}
    kinetic, potential = field.energies
    constants, found = dict[str, Any](), dict[str, PackedEnergy | None]()
    if isinstance(potential, CentralBody):
        constants["central"] = potential.mass * potential.mu
        potential = potential.remainder
    if isinstance(kinetic, Quadratic):
        constants["mass"] = kinetic.factor
    else:
        found["kinetic"] = _packed_energy(kinetic, dof)
    found["potential"] = _packed_energy(potential, dof)
    whole = {name: energy for name, energy in found.items() if energy is not None}
    return (whole if len(whole) == len(found) else {}), constants


def _packed_energy(energy: Any, dof: int) -> PackedEnergy | None:
    """Return an energy in the library's format; None for an unknown kind."""
    if type(energy) is not NetworkEnergy:
        return None
    nearest = float(energy.nearest) if energy.falloff else 1.0
    return _packed(energy.network, dof, energy.inputs, None, float(energy.unit), energy.falloff, nearest)


def _packed(
    network: Any,
    dof: int,
    positions: InputMap,
    straight: Cartesian | None,
    unit: float,
    falloff: float = 0.0,
    nearest: float = 1.0,
) -> PackedEnergy | None:
    """Return a network with its inputs in the library's format; None for an unknown kind."""
    known = type(network) is Perceptron and type(positions) in MAPS
    if not known or network.activation.value not in KNOWN:
        return None
    layers, others = network.layers(), 0 if straight is None else straight.size
    up = torch.cat([_tiled(weight).flatten() for weight in layers.weights])
    down = torch.cat([_tiled(weight.T).flatten() for weight in layers.weights[::-1]])
    bias = torch.stack([pad(one, (0, -len(one) % ROWS)) for one in layers.biases])
    shift, scale = _affine(positions, straight, dof)
    tensors = up, down, bias.unsqueeze(-1).expand(-1, -1, MEMBERS), layers.last, shift, scale
    owners = tuple(part.clone(memory_format=torch.contiguous_format) for part in tensors)
    logs = (positions.middle, positions.spread) if isinstance(positions, Isotropic | Radial) else (0.0, 1.0)
    constants = EnergyConstants(
        *(MAPS.index(type(positions)), dof, others, positions.size + others, len(layers.last)),
        *(len(layers.weights), KNOWN.index(network.activation.value)),
        *(part.data_ptr() for part in owners),
        *(float(network.output.bias), unit, falloff, nearest, *map(float, logs)),
    )
    return PackedEnergy(constants, owners)


def _affine(positions: InputMap, straight: Cartesian | None, dof: int) -> tuple[Tensor, Tensor]:
    """Return shifts and scales of the coordinates; those of positions with a non-affine map are unused."""
    unused = torch.ones(dof, dtype=torch.float64)
    first = (positions.affine.shift, positions.affine.scale) if isinstance(positions, Cartesian) else None
    shift, scale = first or (unused, unused)
    if straight is None:
        return shift, scale
    return torch.cat((shift, straight.affine.shift)), torch.cat((scale, straight.affine.scale))


def _tiled(matrix: Tensor) -> Tensor:
    """Return a matrix padded with rows of zeros to a whole number of tiles."""
    return pad(matrix, (0, 0, 0, -len(matrix) % ROWS))
