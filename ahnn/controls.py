"""Controls over time: each is held until the next, or they are interpolated linearly."""

from __future__ import annotations

import hashlib
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.numbers import Numbers, as_float64

NEAR = 1e-9
"""Two times are one where they differ by less than this part of the span."""


class ControlTable(NamedTuple):
    """Controls over time.

    Attributes:
        times: (T,) increasing.
        values: (T, m), those of each time on; (B, T, m) for B members.
        linear: whether they are interpolated linearly; else they are held.
    """

    times: Tensor
    values: Tensor
    linear: bool = False

    @classmethod
    def of(cls, times: Numbers, values: Numbers, *, linear: bool = False) -> ControlTable:
        """Return the table of numbers; raises UserError for times that do not increase, or other shapes."""
        moments, given = as_float64(times, "times"), as_float64(values, "controls")
        fits = moments.ndim == 1 and len(moments) > 0 and given.shape[-2:-1] == moments.shape
        if not fits or not bool((moments.diff() > 0).all()) or not bool(given.isfinite().all()):
            message = (
                "controls: expected times (T,) that increase and finite controls (T, m); received "
                f"{tuple(moments.shape)} and {tuple(given.shape)}"
            )
            raise UserError(message)
        return cls(moments, given, linear)

    def begun(self, times: Tensor, near: float = 0.0) -> tuple[Tensor, Tensor]:
        """Return values and rates (..., K, m) from each of K times on.

        Before the first time and after the last the controls there are held.

        Args:
            times: (K,).
            near: what a time may lie before one of the table and is that.
        """
        last = torch.searchsorted(self.times, times + near, right=True) - 1
        inside = (last >= 0) & (last < len(self.times) - 1)
        here, after = last.clamp(min=0), torch.where(inside, last + 1, last.clamp(min=0))
        values = self.values[..., here, :]
        if not self.linear:
            return values, torch.zeros_like(values)
        gap = torch.where(inside, self.times[after] - self.times[here], 1.0).unsqueeze(-1)
        rates = (self.values[..., after, :] - values) / gap
        return values + (times - self.times[here]).unsqueeze(-1) * rates, rates

    def at(self, times: Tensor) -> Tensor:
        """Return the controls (..., K, m) at times (K,) from the first on; the last ones are held.

        Raises:
            UserError: a time before the first.
        """
        near = NEAR * float(times[-1] - times[0])
        if float(times[0]) < float(self.times[0]) - near:
            message = (
                f"controls: expected them from the start on, at {float(times[0]):g}; received the first at "
                f"{float(self.times[0]):g}"
            )
            raise UserError(message)
        return self.begun(times, near)[0]

    def over(self, times: Tensor) -> ControlTable:
        """Return the controls at times (K,) and at their own between these.

        No step from one time of it to the next crosses a jump.
        """
        low, high = torch.searchsorted(self.times, times[[0, -1]]).tolist()
        whole = merged(times, self.times[low:high])
        return ControlTable(whole, self.at(whole), self.linear)

    def hash_before(self, time: float) -> str:
        """Return the hash of what decides the controls before a time: rows added behind it change nothing."""
        end = int(torch.searchsorted(self.times, time)) + int(self.linear)
        parts = (part[:end].contiguous().numpy().tobytes() for part in (self.times, self.values))
        return hashlib.blake2b(b"".join(parts), digest_size=16).hexdigest() + "-linear" * self.linear


def merged(times: Tensor, others: Tensor) -> Tensor:
    """Return times (K,) and those of others between them, increasing, each once."""
    near = NEAR * float(times[-1] - times[0])
    after = torch.searchsorted(times, others).clamp(1, len(times) - 1)
    gap = torch.minimum((others - times[after - 1]).abs(), (times[after] - others).abs())
    inside = (others > times[0]) & (others < times[-1]) & (gap > near)
    return torch.cat((times, others[inside])).sort().values
