"""Shared types: the legend of tensor shapes, and the interfaces between packages.

Shape suffixes, used in names and docstrings everywhere:

    B  batch              T  time samples        W  window, steps in the loss
    D  state, D = 2n      S  sigma points        M  measurement
    K  intervals between measurements            N  integrator steps in them

A state is x = [q, p] along the last axis, shape (..., 2n), in the physical units of its space.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor

from ahnn.clock import Clock
from ahnn.errors import UserError

TimeStep = float | Tensor
"""A time step in the unit of the space: a number, or a (B,) tensor with one step per member."""


PART = 2**27
"""Number of bytes of states processed at once; stored data may exceed the memory."""


class VectorField(Protocol):
    """Right-hand side of an autonomous ordinary differential equation."""

    def __call__(self, x: Tensor) -> Tensor:
        """Return dx/dt, shape (..., D), at the states x, shape (..., D)."""
        ...


@runtime_checkable
class SeparableField(Protocol):
    """Vector field of a separable Hamiltonian T(p) + V(q): dq/dt depends only on p, dp/dt only on q."""

    def __call__(self, x: Tensor) -> Tensor:
        """Return dx/dt, shape (..., D), at the states x, shape (..., D)."""
        ...

    def velocity(self, p: Tensor) -> Tensor:
        """Return dq/dt = dT/dp, shape (..., n), at the momenta p, shape (..., n)."""
        ...

    def force(self, q: Tensor) -> Tensor:
        """Return dp/dt = -dV/dq, shape (..., n), at the positions q, shape (..., n)."""
        ...


class Flow(Protocol):
    """State transition over one time step: exact, integrated or learned."""

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Propagate states x, shape (B, D), over dt; return (B, D)."""
        ...


def in_short(values: tuple[Any, ...]) -> str:
    """Return one line for a named tuple, with shapes in place of tensors."""
    fields = zip(values._fields, values, strict=True)  # pyright: ignore[reportAttributeAccessIssue]
    parts = (f"{name}={tuple(v.shape) if isinstance(v, Tensor) else v!r}" for name, v in fields)
    return f"{type(values).__name__}({', '.join(parts)})"


class Units(NamedTuple):
    """Names of the physical units, "1" if dimensionless.

    Tensors are neither converted to these units nor checked against them, nor are the units checked against
    each other; any name is accepted as a label. Choose units that fit together, such as s, km and km/s.
    Values in files are converted by their units, which must be known.

    Attributes:
        time: unit of times and steps.
        position: unit of positions; with "rad", all coordinates are angles.
        velocity: unit of dq/dt, position per time.
        energy: unit of energies.
    """

    time: str = "1"
    position: str = "1"
    velocity: str = "1"
    energy: str = "1"


class Space(NamedTuple):
    """Description of a state space: names, units and conventions, without equations of motion.

    Attributes:
        name: name of the system, in folders and tables.
        components: names of the 2n state components, positions first.
        units: units of time, position, velocity and energy.
        inertia: the factor m of p = m dq/dt, or one for each coordinate; momenta divided by it are
            velocities.
        frame: reference frame of the positions, such as `EME2000, EARTH`; "" if unspecified.
        mechanical: whether p = m dq/dt holds; momenta of other Hamiltonians, with a mass matrix or in a
            rotating frame, are not labelled velocities (`ahnn.labels`).
        controls: names of external inputs on which the motion depends.
        angles: names of coordinates that are angles in rad, with period 2 pi; if positions are in rad, all
            coordinates are angles.
    """

    name: str
    components: tuple[str, ...]
    units: Units = Units()
    inertia: float | tuple[float, ...] = 1.0
    frame: str = ""
    mechanical: bool = True
    controls: tuple[str, ...] = ()
    angles: tuple[str, ...] = ()

    @property
    def angular(self) -> list[bool]:
        """Mask of the coordinates that are angles, n values."""
        every = self.units.position == "rad"
        return [every or name in self.angles for name in self.components[: self.dof]]

    @property
    def dof(self) -> int:
        """Degrees of freedom n.

        Raises:
            UserError: the components are not pairs of positions and momenta.
        """
        size = len(self.components)
        if size < 2 or size % 2:
            message = f"space: expected 2n components, positions first; received {size}: {self.components}"
            raise UserError(message)
        return size // 2

    @property
    def factor(self) -> float | Tensor:
        """The factor m of p = m dq/dt: a number, or (n,) float64 if coordinates differ."""
        return as_factor(self.inertia)

    @property
    def divisor(self) -> float | Tensor:
        """Divisor of momenta in output: m if this gives velocities, else 1."""
        return self.factor if self.mechanical else 1.0

    @property
    def scales(self) -> Tensor:
        """Divisor of each state component in output, (2n,) float64."""
        ones = torch.ones(self.dof, dtype=torch.float64)
        return torch.cat((ones, ones * self.divisor))

    @property
    def mass(self) -> float:
        """The mass, common to all coordinates.

        Raises:
            UserError: coordinates with different masses.
        """
        factor = self.factor
        if isinstance(factor, Tensor):
            message = f"{self.name}: expected one mass for all coordinates; received {self.inertia}"
            raise UserError(message)
        return factor


def as_factor(inertia: float | Sequence[float]) -> float | Tensor:
    """Return the factor m of p = m dq/dt: a number, or (n,) float64 if coordinates differ."""
    if isinstance(inertia, Sequence):
        return inertia[0] if len({*inertia}) == 1 else torch.tensor(inertia, dtype=torch.float64)
    return inertia


class Trajectories(NamedTuple):
    """Sampled trajectories of one system, padded to a common number of samples.

    Attributes:
        states: (B, T, D) float64; a sample with any NaN is missing.
        times: (B, T) float64, increasing in each row; NaN only where the sample is missing. (T,) times are
            shared by all trajectories.
        controls: (B, T, m) float64, each valid from its sample; None without controls.
        linear: whether controls are interpolated linearly between samples instead of held.
    """

    states: Tensor
    times: Tensor
    controls: Tensor | None = None
    linear: bool = False

    def __repr__(self) -> str:
        return in_short(self)

    def clock(self, count: int) -> Clock | None:
        """Return the first k = `count` clock coordinates of all samples, (B, T, k); None for k = 0."""
        return Clock.of(self.times, self.controls, self.linear).first(count) if count else None

    @property
    def present(self) -> Tensor:
        """(B, T) bool, whether a sample is present."""
        return self.states.isfinite().all(-1) & self.times.isfinite()

    def each_timed(self) -> Trajectories:
        """Return the trajectories with times (B, T); shared times (T,) are expanded without a copy."""
        return self._replace(times=self.times.expand(self.states.shape[:2]))

    def part(self, rows: slice) -> Trajectories:
        """Return selected trajectories; times (T,) that all share are kept."""
        controls = None if self.controls is None else self.controls[rows]
        times = self.times[rows] if self.times.ndim > 1 else self.times
        return self._replace(states=self.states[rows], times=times, controls=controls)

    def parts(self) -> Iterator[Trajectories]:
        """Yield all trajectories in order, in batches of at most `PART` bytes."""
        many = rows_of_part(*self.states.shape[1:])
        for begin in range(0, len(self.states), many):
            yield self.part(slice(begin, begin + many))

    def spread(self) -> Trajectories:
        """Return an evenly spaced subset of at most `PART` bytes: all trajectories if they fit."""
        return self.part(slice(None, None, -(-len(self.states) // rows_of_part(*self.states.shape[1:]))))


def rows_of_part(samples: int, size: int) -> int:
    """Return how many trajectories of given samples and components each fit into `PART`, at least one."""
    return max(1, PART // (8 * samples * size))


class Window(NamedTuple):
    """A batch of W consecutive steps.

    Increments, not states, are the targets: x_{k+1} - x_k is formed in float64 before any cast, since at
    6e4 km a float32 state resolves only 4 m.

    Attributes:
        start: (B, D) first state of each window.
        increments: (B, W, D), row k is x_{k+1} - x_k.
        dt: common step length, or (B, W) step lengths.
        weight: factor of the batch's mean loss. It is 1 unless several devices divide a batch into unequal
            parts: B divided by the mean number of windows per part, so that the mean over devices equals that
                over all windows; 0 for an empty part, which then contains one ignored window.
    """

    start: Tensor
    increments: Tensor
    dt: TimeStep
    weight: float = 1.0

    def step(self, k: int) -> TimeStep:
        """Return the length of step k, in the form used by integrators."""
        return self.dt[:, k] if isinstance(self.dt, Tensor) else self.dt

    def first(self, steps: int) -> Window:
        """Return the windows truncated to their first steps."""
        dt = self.dt[:, :steps] if isinstance(self.dt, Tensor) else self.dt
        return self._replace(increments=self.increments[:, :steps], dt=dt)

    def rows(self, part: slice) -> Window:
        """Return selected windows."""
        dt = self.dt[part] if isinstance(self.dt, Tensor) else self.dt
        return self._replace(start=self.start[part], increments=self.increments[part], dt=dt)
