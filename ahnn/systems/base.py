"""Base class of physical systems: energy, field, initial states and units."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Annotated, Any, ClassVar

import torch
from torch import Generator, Tensor

from ahnn.arguments import Count, Interval, Positive, Range, Within, check_values
from ahnn.dynamics.forced import clock_size, forced
from ahnn.dynamics.forces import Force
from ahnn.errors import UserError
from ahnn.types import Flow, Space, Units, as_factor

Eccentricity = Annotated[tuple[float, float] | list[float], Interval(Within(0, below=1))]
"""Range of eccentricities of closed orbits."""


@dataclass(frozen=True)
class FilterNoise:
    """Default statistics of a filter on this system, as standard deviations.

    Attributes:
        position: initial error of each position.
        velocity: initial error of each velocity.
        measurement: noise of a measured position component.
    """

    position: float
    velocity: float
    measurement: float


@dataclass(frozen=True, kw_only=True)
class System(ABC):
    """Hamiltonian system, by default T(p) + V(q), as ground truth for data and floors.

    A subclass is a frozen dataclass whose fields are its physical constants; all enter the hash under which
    generated trajectories are cached. With additional `forces`, states are extended by time and controls as
    needed (`ahnn.clock`). A system whose T(p) is not p^2 / 2m overrides `velocity`. A system whose H is not
    T(p) + V(q) overrides `hamiltonian` and `separable`, and needs no `force`, like `MassMatrixSystem` with
    p = M(q) dq/dt.

    Attributes:
        name: name in folders and tables.
        dt: sampling interval, in the time unit of the system.
        steps: number of sampling intervals of a trajectory.
        dof: degrees of freedom n; a state has 2n components.
        components: names of the state components, positions first.
        units: units of time, position, velocity and energy.
        integrator: name of the method that generates the truth.
        noise: default standard deviations for a filter.
        mass: mass in the unit of the system.
        constants: fields on which the force depends besides the position, except the mass.
        controls: names of external inputs on which forces may depend.
        angles: names of angular coordinates; all of them if positions are in rad.
        linear: whether controls are interpolated linearly between samples instead of held.
        singular: whether the force is infinite at some places, near which the truth needs shorter steps.
    """

    name: str
    dt: Positive
    steps: Count

    dof: ClassVar[int]
    components: ClassVar[tuple[str, ...]]
    units: ClassVar[Units]
    integrator: ClassVar[str]
    noise: ClassVar[FilterNoise]
    constants: ClassVar[tuple[str, ...]] = ()
    controls: ClassVar[tuple[str, ...]] = ()
    angles: ClassVar[tuple[str, ...]] = ()
    linear: ClassVar[bool] = False
    singular: ClassVar[bool] = False
    mass: Positive = 1.0

    def __post_init__(self) -> None:
        """Raise UserError for the first invalid parameter."""
        check_values("", type(self), {field.name: getattr(self, field.name) for field in fields(self)})

    @abstractmethod
    def energy(self, x: Tensor) -> Tensor:
        """Return H, shape (...), of the states x, shape (..., D)."""

    def force(self, q: Tensor) -> Tensor:
        """Return dp/dt = -dV/dq, shape (..., n), at the positions q, shape (..., n).

        Raises:
            UserError: the system defines neither this method nor `hamiltonian` with `separable` False.
        """
        message = (
            f"system {self.name}: expected the method `force`; received none. Define -dV/dq, or, where H is "
            "not T(p) + V(q), override `hamiltonian` and set `separable` to False"
        )
        raise UserError(message)

    @abstractmethod
    def initial_states(self, count: int, generator: Generator) -> Tensor:
        """Draw the initial states of `count` trajectories, shape (count, D), float64."""

    @property
    def inertia(self) -> float | tuple[float, ...]:
        """Factor m of the kinetic energy p^2 / 2m, or one per coordinate."""
        return self.mass

    @cached_property
    def forces(self) -> Sequence[Force]:
        """Additional non-Hamiltonian forces, defined by subclasses."""
        return ()

    @cached_property
    def clock(self) -> int:
        """Number of clock coordinates: 0, 1 for time-dependent forces, 1 + m for controls."""
        return clock_size(self.forces, len(self.controls))

    def signal(self, times: Tensor, count: int, generator: Generator) -> Tensor | None:
        """Draw controls of `count` trajectories at times (T,), shape (count, T, m); None without controls.

        Systems with controls override this method.
        """
        return None

    @property
    def separable(self) -> bool:
        """Whether H = T(p) + V(q) without additional forces, as symplectic compositions require."""
        return not self.forces

    def parameters(self) -> dict[str, Any]:
        """Return the complete definition of equations and initial states, as plain values."""
        return asdict(self)

    @property
    def mechanical(self) -> bool:
        """Whether p = m dq/dt, derived from the overridden methods."""
        kinetic = type(self).velocity is System.velocity
        return kinetic and (self.separable or type(self).hamiltonian is System.hamiltonian)

    @property
    def space(self) -> Space:
        """Description of the state components."""
        own = self.name, self.components, self.units, self.inertia
        return Space(*own, mechanical=self.mechanical, controls=self.controls, angles=self.angles)

    def velocity(self, p: Tensor) -> Tensor:
        """Return dq/dt = dT/dp, by default p / m, shape (..., n), at the momenta p, shape (..., n)."""
        return p / as_factor(self.inertia)

    def hamiltonian(self, x: Tensor) -> Tensor:
        """Return Hamilton's field (dH/dp, -dH/dq), shape (..., 2n), at the states x, shape (..., 2n)."""
        q, p = x.chunk(2, dim=-1)
        return torch.cat((self.velocity(p), self.force(q)), dim=-1)

    def __call__(self, x: Tensor) -> Tensor:
        """Return dx/dt, including forces, shape (..., D), at the states x, shape (..., D)."""
        return forced(self.hamiltonian, self.forces, x, self.clock) if self.forces else self.hamiltonian(x)

    def compiled(self, flow: Flow, longest: float) -> Flow:
        """Return the exact flow with steps of at most `longest`, in a faster implementation if available."""
        return flow

    def durations(self, x: Tensor) -> Tensor:
        """Return the number of steps, shape (B,), of the trajectories that start at x, shape (B, D)."""
        return torch.full((x.shape[0],), self.steps, dtype=torch.int64)

    def phases(self, x: Tensor) -> dict[str, Tensor]:
        """Return masks of phases of the motion for states x, shape (..., D): (...) bool by name.

        An estimator that is consistent on average may be inconsistent in each phase. By default phases are
        thirds of the states by size of the force, or of dp/dt for a system without `force`.
        """
        alone = type(self).force is System.force
        force = self.hamiltonian(x).chunk(2, dim=-1)[1] if alone else self.force(x.chunk(2, dim=-1)[0])
        force = force.norm(dim=-1)
        low, high = (force[force.isfinite()].quantile(part) for part in (1 / 3, 2 / 3))
        middle = (force > low) & (force <= high)
        return {"weak force": force <= low, "medium force": middle, "strong force": force > high}

    def deviations(self) -> Tensor:
        """Return the default standard deviations of the initial state error, shape (D,)."""
        ones = torch.ones(self.dof, dtype=torch.float64)
        return torch.cat((self.noise.position * ones, self.noise.velocity * as_factor(self.inertia) * ones))


def uniform(interval: Range, count: int, generator: Generator) -> Tensor:
    """Draw `count` numbers uniformly from a closed interval, shape (count,), float64."""
    low, high = interval
    return low + (high - low) * torch.rand(count, generator=generator, dtype=torch.float64)
