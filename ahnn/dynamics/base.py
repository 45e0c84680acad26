"""Base class of learned dynamics: a module that propagates a state over a time step."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import torch
from torch import Tensor, nn

from ahnn.errors import UserError
from ahnn.numbers import described
from ahnn.rollouts import rollout
from ahnn.statistics import Statistics
from ahnn.types import TimeStep

if TYPE_CHECKING:
    from typing_extensions import TypeIs


class Dynamics(nn.Module, ABC):
    """Map from a state and a time step to the state's increment.

    Dynamics that depend on time or controls propagate extended states z (`ahnn.clock`), (B, 2 (n + k)),
    instead of x.

    Attributes:
        spec: plain values from which `make_dynamics` builds the same module, except for the weights.
        assumes: prior knowledge about the dynamics, stated with every score.
        clock: number k of clock coordinates of the states: 0, 1 for time, 1 + m for time and m controls.
        begins_known: whether the learned part is zero before training, so that only known physics acts.
        anchored: whether the dynamics fix the origin of the positions, so that a common bias is detectable.
    """

    spec: dict[str, Any]
    assumes: str
    clock: int = 0
    anchored: bool = True
    begins_known: bool = False

    @property
    def own_step(self) -> float | None:
        """The fixed step of a map; None for dynamics that accept any step."""
        return None

    def require(self, dt: TimeStep) -> None:
        """Raise UserError for a step other than the fixed step of a map."""
        if not torch.compiler.is_exporting() and (step := self.own_step) is not None:  # graphs have one step
            require_step(step, dt)

    @abstractmethod
    def fit(self, statistics: Statistics) -> None:
        """Set scalings and units from the training split."""

    @abstractmethod
    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return x(t + dt) - x(t), shape (B, D), predicted for the states x, shape (B, D)."""

    def seen(self, x: Tensor) -> Tensor:
        """Return the network inputs, (..., F), for states x, (..., D); by default the states themselves."""
        return x

    def forward(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Propagate states x, shape (B, D), over dt, a number or (B,); return (B, D).

        Raises:
            UserError: x is not a tensor of states along its last axis, or dt has another shape or is not the
                fixed step of a map.
        """
        self.require(dt)
        dof = getattr(self, "spec", {}).get("dof")
        allowed = ((2 * dof,), (2 * (dof + self.clock),)) if dof else ()  # the field reports a missing time
        if not isinstance(x, Tensor) or (dof and x.shape[-1:] not in allowed):
            components = f"{2 * (dof + self.clock)} components" if dof else "states"
            message = (
                f"dynamics: expected a tensor with {components} along its last axis; received {described(x)}"
            )
            raise UserError(message)
        if isinstance(dt, Tensor) and dt.ndim:
            fits = dt.ndim == x.ndim - 1
            if not fits or any(a not in (1, b) for a, b in zip(dt.shape, x.shape, strict=False)):
                received = f"{described(dt)} for {described(x)}"
                message = f"dt: expected a number, or one for each state; received {received}"
                raise UserError(message)
        return x + self.increment(x, dt)

    def rollout(self, start: Tensor, steps: int, dt: TimeStep) -> Tensor:
        """Return trajectories, shape (B, steps + 1, D), which begin with the states `start`, (B, D).

        Gradients flow to all tensors that require them; `torch.no_grad` saves memory.

        Args:
            start: (B, D) states.
            steps: number of steps.
            dt: step length, or (B, steps) step lengths.

        Raises:
            UserError: `start` or `dt` has a wrong shape, or `steps` is not an integer >= 0.
        """
        shapes = ((), (len(start), steps)) if isinstance(start, Tensor) and start.ndim == 2 else ()
        if not isinstance(steps, int) or steps < 0 or getattr(dt, "shape", ()) not in shapes:
            message = (
                "rollout: expected states (B, D), a number of steps >= 0, and their length or (B, steps) "
                f"lengths; received {described(start)}, {steps!r} and {described(dt)}"
            )
            raise UserError(message)
        return rollout(self, start, dt, steps + 1, gradients=torch.is_grad_enabled())

    def __repr__(self) -> str:
        options = [
            f"{k}={v!r}" for k, v in vars(self).get("spec", {}).items() if k != "kind" and v is not None
        ]
        return f"{type(self).__name__}({', '.join(options)})" if options else super().__repr__()

    def frozen(self) -> Dynamics:
        """Return a float64 copy without gradients, for evaluation and filters."""
        return copy.deepcopy(self).double().eval().requires_grad_(False)


def require_step(step: float, dt: TimeStep) -> None:
    """Raise UserError for steps other than the training step: a map is not continuous in time."""
    off = float((dt - step).abs().max()) if isinstance(dt, Tensor) else abs(dt - step)
    if not off <= 1e-6 * step:
        received = "steps that differ" if isinstance(dt, Tensor) else f"{dt:.6g}"
        message = (
            f"model: expected the step used in training, {step:.6g}; received {received}. A map has no time "
            "axis: give times at multiples of the step, or use node, hnn or ahnn"
        )
        raise UserError(message)


class HasField(Protocol):
    """Dynamics that have a vector field: x -> dx/dt, shape (..., D)."""

    @property
    def field(self) -> nn.Module:
        """The vector field."""
        ...


def has_field(dynamics: object) -> TypeIs[HasField]:
    """Return whether dynamics have a field.

    A run-time protocol check would miss the field: from Python 3.12 on it bypasses `__getattr__`, through
    which torch modules expose submodules.
    """
    return callable(getattr(dynamics, "field", None))


@runtime_checkable
class HasEnergy(Protocol):
    """Dynamics that have a Hamiltonian."""

    def energy(self, x: Tensor) -> Tensor:
        """Return H, shape (...), at the states x, shape (..., D)."""
        ...
