"""Propagation of a batch of paths in segments, with sensitivities to starts and parameters."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad
from torch.nn.utils import parameters_to_vector

from ahnn.clock import Clock, extended, reduced_jacobians
from ahnn.dynamics import Dynamics
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.dynamics.variations import own_jacobians
from ahnn.rollouts import stepped
from ahnn.shooting.path_sensitivities import Steps, in_quarters, sensitivities
from ahnn.uncertainty import Domain, growth


class Knowledge(NamedTuple):
    """Uncertainty information on learned dynamics and starts.

    Attributes:
        spread: factor (P, R) of the covariance of the parameters, or None.
        domain: training domain, or None.
        start: factor (D, D) or (B, D, D) of the covariance of the starts, or None for exact starts.
    """

    spread: Tensor | None = None
    domain: Domain | None = None
    start: Tensor | None = None

    @property
    def columns(self) -> int:
        """Number of columns of a state's covariance factor; 0 if the covariance is unknown."""
        of_starts = 0 if self.start is None else self.start.shape[-1]
        return of_starts + (0 if self.spread is None else self.spread.shape[1])


PathPart = tuple[Tensor, Tensor | None, Tensor | None]
"""States (B, N, D) of a part of a path, with covariances (B, N, D, D) and novelty (B, N) where known."""


class FollowedPath:
    """Current states of a batch of paths, with sensitivities to start and parameters.

    With `factors`, parts contain factors of the covariances, in float64, instead of the covariances.
    """

    def __init__(self, dynamics: Dynamics, known: Knowledge, *, factors: bool = False) -> None:
        self.dynamics, self.known, self.quartered = dynamics, known, False
        self.factors, self.dtype = factors, torch.float64 if factors else torch.float32
        if known.columns:
            self.jacobians = own_jacobians(dynamics, self.dtype)
        if known.spread is not None:
            self.theta = parameters_to_vector(dynamics.parameters()).detach()
            self.field_columns = field_jacobian(dynamics, self.dtype)  # pyright: ignore[reportArgumentType]

    def begin(self, start: Tensor) -> PathPart:
        """Set the starts (B, D) and return them as a part."""
        self.x, size, states = start, start.shape[1], start.unsqueeze(1)
        moved = start.new_zeros(len(start), size, self.known.columns)
        if self.known.start is not None:
            moved[..., -size:] = self.known.start
        self.moved = moved.to(self.dtype)
        return states, self._covariances(moved.unsqueeze(1)), self._novelty(states)

    def follow(self, lengths: Tensor, clock: Clock | None = None) -> PathPart:
        """Take steps of lengths (N,), starting at a clock reading, and return the part after each step."""
        states = torch.stack([self.x, *self._steps(self.x, lengths, clock)], dim=1)
        novelty = self._novelty(states)
        self.x = states[:, -1]
        later = None if novelty is None else novelty[:, 1:]
        if not self.known.columns:
            return states[:, 1:], None, later
        moved = self._columns(states, lengths.expand(len(states), -1), novelty, clock)
        self.moved = moved[:, -1]
        return states[:, 1:], self._covariances(moved[:, 1:]), later

    def _columns(
        self, states: Tensor, lengths: Tensor, novelty: Tensor | None, clock: Clock | None
    ) -> Tensor:
        """Return the covariance factors at states (B, N + 1, D), shape (B, N + 1, D, R)."""
        steps = Steps(lengths, torch.arange(lengths.shape[1] + 1))
        if self.quartered:
            steps, states = steps.quarters(), in_quarters(self.dynamics.increment, states, lengths)
            novelty = self._novelty(states)
        if clock is None:
            jacobians = self.jacobians(states[:, :-1], steps.lengths)
        else:
            begun = extended(states[:, :-1], clock)
            jacobians = reduced_jacobians(self.jacobians(begun, steps.lengths), clock.values.shape[-1])
        return sensitivities(jacobians, self._forcing(states, novelty), steps, self.moved)

    def _forcing(self, states: Tensor, novelty: Tensor | None) -> Tensor:
        """Return the forcing of the columns (B, N, L, R): nonzero for parameters, zero for starts."""
        if self.known.spread is None:
            return states.new_zeros(*states.shape, self.known.columns, dtype=self.dtype)
        forcing = self.field_columns(self.theta, states) @ self.known.spread.to(self.dtype)
        if novelty is not None:
            forcing = forcing * growth(novelty)[..., None, None].to(self.dtype)
        return pad(forcing, (0, self.known.columns - forcing.shape[-1]))

    def _covariances(self, moved: Tensor) -> Tensor | None:
        """Return M M^T, or M, in float64; in float32, M M^T could have negative eigenvalues."""
        wide = moved.double()
        if self.factors:
            return wide
        return wide @ wide.mT if self.known.columns else None

    def end(self, x: Tensor, lengths: Tensor, clock: Clock | None = None) -> Tensor:
        """Return the states (S, B, D) after steps of lengths (N,) from states x (S, B, D)."""
        together = x.flatten(0, 1).unsqueeze(0) if clock is None else x  # a clock may differ between paths
        ends = [list(self._steps(states, lengths, clock))[-1] for states in together]
        return torch.stack(ends).view_as(x)

    def _steps(self, x: Tensor, lengths: Tensor, clock: Clock | None) -> Iterator[Tensor]:
        for k, dt in enumerate(lengths.tolist()):
            x = stepped(self.dynamics, x, dt, None if clock is None else clock.at(k))
            yield x

    def _novelty(self, states: Tensor) -> Tensor | None:
        return None if self.known.domain is None else self.known.domain.novelty(self.dynamics, states)
