"""Vocabulary of the whole package: the legend of tensor shapes, and the interfaces at its seams.

Shape suffixes, used in names and docstrings everywhere:

    B  batch              T  time samples        W  window, steps in the loss
    D  state, D = 2n      S  sigma points        M  measurement

A state is x = [q, p] along the last axis, shape (..., 2n), in the physical units of its system.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

from torch import Tensor

TimeStep = float | Tensor
"""A time step in the units of the system: one number, or a (B,) tensor with one step per member."""


class VectorField(Protocol):
    """Right-hand side of an autonomous ordinary differential equation."""

    def __call__(self, x: Tensor) -> Tensor:
        """Return dx/dt, shape (..., D), at the states x, shape (..., D)."""
        ...


@runtime_checkable
class SeparableField(Protocol):
    """Field of a separable Hamiltonian T(p) + V(q): dq/dt depends on p alone, dp/dt on q alone."""

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
    """Map of a state over one time step: exact, integrated or learned."""

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (B, D) that the states x, shape (B, D), reach after dt."""
        ...


class Trajectories(NamedTuple):
    """Sampled trajectories of one system, padded at their end to a common length.

    Attributes:
        states: (B, T, D) float64; row b is valid for its first `lengths[b]` samples, NaN beyond.
        lengths: (B,) int64, number of valid samples.
        dt: sampling interval in the time unit of the system.
    """

    states: Tensor
    lengths: Tensor
    dt: float


class Window(NamedTuple):
    """A batch of W consecutive steps.

    Increments, not states, are the targets: x_{k+1} - x_k is formed in float64 before any cast, since at
    6e4 km a float32 state resolves only 4 m.

    Attributes:
        start: (B, D) first state of each window.
        increments: (B, W, D), row k is x_{k+1} - x_k.
        dt: sampling interval.
        share: factor of the batch's mean loss. It is 1 unless several devices divide a batch into unequal
            parts: B windows over the mean number of a part, so that the mean over the devices is that of all
            windows; 0 for a part without any, which then holds one window that does not count.
    """

    start: Tensor
    increments: Tensor
    dt: float
    share: float = 1.0
