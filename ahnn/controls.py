"""Controls as functions of time: piecewise constant or linearly interpolated."""

from __future__ import annotations

import hashlib
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.numbers import Numbers, as_float64

NEAR = 1e-9
"""Relative tolerance, as a fraction of the time span, within which two times are equal."""


class ControlTable(NamedTuple):
    """Tabulated controls.

    Attributes:
        times: (T,) increasing.
        values: (T, m), each valid from its time; (B, T, m) for B members.
        linear: whether values are interpolated linearly instead of held.
    """

    times: Tensor
    values: Tensor
    linear: bool = False

    @classmethod
    def of(cls, times: Numbers, values: Numbers, *, linear: bool = False) -> ControlTable:
        """Build a validated table; raises UserError for times that do not increase, or wrong shapes."""
        moments, given = as_float64(times, "times"), as_float64(values, "controls")
        fits = moments.ndim == 1 and len(moments) > 0 and given.shape[-2:-1] == moments.shape
        if not fits or not bool((moments.diff() > 0).all()) or not bool(given.isfinite().all()):
            message = (
                "controls: expected increasing times (T,) and finite controls (T, m); received "
                f"{tuple(moments.shape)} and {tuple(given.shape)}"
            )
            raise UserError(message)
        return cls(moments, given, linear)

    def begun(self, times: Tensor, near: float = 0.0) -> tuple[Tensor, Tensor]:
        """Return values and rates (..., K, m) valid from each of K times.

        Outside the table the first or last controls apply.

        Args:
            times: (K,).
            near: tolerance by which a time may precede a table time and still match it.
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
        """Return the controls (..., K, m) at times (K,); after the end of the table the last ones apply.

        Raises:
            UserError: a time before the beginning of the table.
        """
        near = NEAR * float(times[-1] - times[0])
        if float(times[0]) < float(self.times[0]) - near:
            message = (
                f"controls: expected values at the start, time {float(times[0]):g}; received the first at "
                f"{float(self.times[0]):g}"
            )
            raise UserError(message)
        return self.begun(times, near)[0]

    def over(self, times: Tensor) -> ControlTable:
        """Return the controls at times (K,) merged with the table's own times between them.

        Then no step between these times crosses a jump.
        """
        low, high = torch.searchsorted(self.times, times[[0, -1]]).tolist()
        whole = merged(times, self.times[low:high])
        return ControlTable(whole, self.at(whole), self.linear)

    def hash_before(self, time: float) -> str:
        """Return a hash of the entries that determine controls before a time; later rows are ignored."""
        end = int(torch.searchsorted(self.times, time)) + int(self.linear)
        parts = (part[:end].contiguous().numpy().tobytes() for part in (self.times, self.values))
        return hashlib.blake2b(b"".join(parts), digest_size=16).hexdigest() + "-linear" * self.linear


def merged(times: Tensor, others: Tensor) -> Tensor:
    """Return the increasing union of times (K,) and the other times between them, without duplicates."""
    near = NEAR * float(times[-1] - times[0])
    after = torch.searchsorted(times, others).clamp(1, len(times) - 1)
    gap = torch.minimum((others - times[after - 1]).abs(), (times[after] - others).abs())
    inside = (others > times[0]) & (others < times[-1]) & (gap > near)
    return torch.cat((times, others[inside])).sort().values
