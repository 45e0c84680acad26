"""Pseudoranges to navigation satellites with constant or tabulated positions."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ahnn.measurements.angles import Differing
from ahnn.measurements.base import Time, check_state
from ahnn.measurements.interpolation import lagrange
from ahnn.numbers import as_float64, described


class GnssRange(Differing):
    """Pseudoranges to N satellites at given positions, in the frame and unit of the state.

    Between table rows, positions are interpolated by a polynomial through the nearest rows (see
    `ahnn.measurements.interpolation`); at row times the result equals the table.

    Args:
        positions: (N, 3), or a (T, N, 3) table with one row for each of `times`.
        times: (T,) times of the table, increasing; None for constant positions.
        order: order of the interpolation, at least 1; the table needs at least order + 1 rows.
        clock: index of the state component that contains the receiver's clock error as a length, negative to
            count from the end; None without clock error.
        unit: unit of a range.

    Raises:
        ValueError: positions or times are not finite, shapes are incompatible, times do not increase, the
            table is too short for the order, a time is outside the table, or a state has no component
            `clock`.
    """

    def __init__(
        self,
        positions: Tensor | Sequence,
        times: Tensor | Sequence[float] | None = None,
        *,
        order: int = 8,
        clock: int | None = None,
        unit: str = "km",
    ) -> None:
        self.positions = _finite(positions, "positions")
        self.times = None if times is None else _finite(times, "times")
        _check_shapes(self.positions, self.times)
        if self.times is not None:
            _check_table(self.times, order)
        self.order = order
        self.clock = clock
        self.names = tuple(f"range{i + 1}" for i in range(self.positions.shape[-2]))
        self.units = (unit,) * len(self.names)

    def __call__(self, x: Tensor, t: Time) -> Tensor:
        """Return the pseudoranges (..., N) of the states x (..., D) at time t."""
        clock = 0 if self.clock is None else self.clock
        check_state(x, max(3, clock + 1, -clock), "GnssRange")
        satellites = self._at(t).to(x)
        ranges = (x[..., None, :3] - satellites).square().sum(-1).sqrt()
        return ranges if self.clock is None else ranges + x[..., self.clock, None]

    def _at(self, t: Time) -> Tensor:
        """Return the satellite positions (N, 3) at time t, or (..., N, 3) at times t, shape (...)."""
        if self.times is None:
            return self.positions
        if isinstance(t, Tensor) and t.ndim:
            times, where = t.unique(return_inverse=True)
            return torch.stack([self._at(float(time)) for time in times])[where]
        try:
            return lagrange(self.times, self.positions, float(t), self.order)
        except ValueError as error:
            message = f"GnssRange: {error}"
            raise ValueError(message) from error


def _finite(value: Tensor | Sequence, name: str) -> Tensor:
    tensor = as_float64(value, f"GnssRange: {name}")
    if not bool(tensor.isfinite().all()):
        first = tuple(int(n) for n in (~tensor.isfinite()).nonzero()[0])
        message = f"GnssRange: expected finite {name}; received {float(tensor[first])} at {list(first)}"
        raise ValueError(message)
    return tensor


def _check_shapes(positions: Tensor, times: Tensor | None) -> None:
    shape = tuple(positions.shape)
    leading = () if times is None else tuple(times.shape)
    fits = len(shape) == 2 + len(leading) and len(leading) < 2 and shape[-1] == 3 and 0 not in shape
    if not fits or shape[:-2] != leading:
        given = "no times" if times is None else f"times {tuple(times.shape)}"
        message = (
            f"GnssRange: expected positions (N, 3) without times, or (T, N, 3) with times (T,); received "
            f"{shape} and {given}"
        )
        raise ValueError(message)


def _check_table(times: Tensor, order: int) -> None:
    if not isinstance(order, int) or order < 1:
        message = f"GnssRange: expected a whole order >= 1; received {order!r} ({described(order)})"
        raise ValueError(message)
    if not bool((times.diff() > 0.0).all()):
        message = f"GnssRange: expected increasing times; received {times.tolist()}"
        raise ValueError(message)
    if len(times) <= order:
        message = (
            f"GnssRange: expected a table of at least {order + 1} rows for order={order}; received "
            f"{len(times)}; tabulate more times, or choose order={len(times) - 1}"
        )
        raise ValueError(message)
