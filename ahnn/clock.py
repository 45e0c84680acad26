"""Extended phase space: time and controls as additional coordinates.

Forces that depend on time t and on controls u make the equations of motion explicit in time. They are
autonomous in the coordinates (q, c) with c = (t, u), whose rates are known: dc/dt = r, dr/dt = 0 (Hairer,
Lubich & Wanner, Geometric Numerical Integration, section VI.1). The extended state is

    z = [q, c, p, r],  shape (..., 2 (n + k)),  k = 0: autonomous, 1: time, 1 + m: time and m controls,

so integrators, derivatives and objectives apply unchanged. Piecewise constant controls have rate 0, linearly
interpolated controls have their slope as rate.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Clock(NamedTuple):
    """Time and controls at given instants.

    Attributes:
        values: c = (t, u), shape (..., k).
        rates: r = (1, du/dt), shape (..., k).
    """

    values: Tensor
    rates: Tensor

    @classmethod
    def of(cls, times: Tensor, controls: Tensor | None, linear: bool = False) -> Clock:
        """Return the clock of samples at times (..., T); controls (..., T, m) are valid from their samples.

        Args:
            times: sample times, (..., T).
            controls: (..., T, m), or None without controls.
            linear: whether controls are interpolated linearly instead of held.
        """
        t = times.unsqueeze(-1)
        one = torch.ones_like(t)
        if controls is None:
            return cls(t, one)
        slopes = torch.zeros_like(controls)
        if linear:
            gaps = t.diff(dim=-2)
            slopes[..., :-1, :] = controls.diff(dim=-2) / gaps
        return cls(torch.cat((t, controls), dim=-1), torch.cat((one, slopes), dim=-1))

    def first(self, count: int) -> Clock:
        """Return the clock reduced to its first k components."""
        return Clock(self.values[..., :count], self.rates[..., :count])

    def of_steps(self) -> Clock:
        """Return the clock at the start of every step, (B (T - 1), k), from a clock of samples, (B, T, k)."""
        return Clock(*(part[:, :-1].flatten(0, 1) for part in self))

    def along(self, lengths: Tensor, ends: Tensor) -> Clock:
        """Return the clock at the start of N integrator steps, (..., N, k), from one of samples, (..., T, k).

        Args:
            lengths: (N,) step lengths.
            ends: (T,) number of steps up to each sample.
        """
        counts = ends.diff()
        since = torch.cat((lengths.new_zeros(1), lengths.cumsum(0)))
        gone = since[:-1] - since[ends[:-1]].repeat_interleave(counts)
        values, rates = (part[..., :-1, :].repeat_interleave(counts, dim=-2) for part in self)
        return Clock(values + gone.unsqueeze(-1) * rates, rates)

    def steps(self, part: Tensor) -> Clock:
        """Return the clock at selected instants (N,) of (..., T, k)."""
        return Clock(self.values[..., part, :], self.rates[..., part, :])

    def at(self, sample: int) -> Clock:
        """Return the clock of one sample, (..., k), of (..., T, k)."""
        return Clock(self.values[..., sample, :], self.rates[..., sample, :])

    def rows(self, part: slice | Tensor) -> Clock:
        """Return the clock of selected trajectories."""
        return Clock(self.values[part], self.rates[part])


def extended(x: Tensor, clock: Clock) -> Tensor:
    """Return extended states z, shape (..., 2 (n + k)), from states x, shape (..., 2n), and a clock."""
    q, p = x.chunk(2, dim=-1)
    shape = x.shape[:-1]
    values, rates = (part.to(x).expand(*shape, part.shape[-1]) for part in clock)
    return torch.cat((q, values, p, rates), dim=-1)


def reduced(z: Tensor, count: int) -> Tensor:
    """Return the states x, shape (..., 2n), within extended states z with k = `count` clock coordinates."""
    if count == 0:
        return z
    first, second = z.chunk(2, dim=-1)
    dof = first.shape[-1] - count
    return torch.cat((first[..., :dof], second[..., :dof]), dim=-1)


def reduced_jacobians(jacobians: Tensor, count: int) -> Tensor:
    """Return the state blocks (..., 2n, 2n) of Jacobians of extended states."""
    return reduced(reduced(jacobians, count).mT, count).mT


def split(z: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return q, c, p and r of extended states z with k = `count` clock coordinates."""
    first, second = z.chunk(2, dim=-1)
    dof = first.shape[-1] - count
    return first[..., :dof], first[..., dof:], second[..., :dof], second[..., dof:]


def on_clock(predicted: Tensor, known: Tensor, count: int) -> Tensor:
    """Return increments, (..., 2 (n + k)), with known clock increments, since controls jump at samples."""
    if count <= 1:
        return predicted
    q, _, p, _ = split(predicted, count)
    _, c, _, r = split(known, count)
    return torch.cat((q, c, p, r), dim=-1)
