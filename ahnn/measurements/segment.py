"""Segments of measurements with their instrument."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.measurements.angles import residual
from ahnn.measurements.base import Measurement
from ahnn.measurements.coloured_noise import Colour, Whitening
from ahnn.measurements.student_noise import normal_scores


class Instrument(NamedTuple):
    """Instrument of measurements, with properties of the observed motion.

    Attributes:
        measurement: measurement model.
        deviations: (M,) noise standard deviations.
        longest: maximum integrator step between measurements.
        dof: degrees of freedom n of the motion.
        inertia: factor m of p = m dq/dt, for momenta from measured positions.
        width: number of samples on either side within which the motion is cubic up to the noise.
        bias: (M,) offset of readings from the true values; None for zeros.
        bias_sd: (M,) standard deviations of the offset, 0 if known; None for zeros.
        colour: correlation of the noise; None for white noise.
        freedom: (M,) degrees of freedom of Student's noise, whose scales are the deviations, inf where it is
            normal; None if all is normal.
        sparse_momenta: whether states are measured with too few momenta to estimate states from them; then
            momenta are estimated from positions.
    """

    measurement: Measurement
    deviations: Tensor
    longest: float
    dof: int
    inertia: float | Tensor
    width: int = 2
    bias: Tensor | None = None
    bias_sd: Tensor | None = None
    colour: Colour | None = None
    freedom: Tensor | None = None
    sparse_momenta: bool = False

    def to(self, device: torch.device) -> Instrument:
        """Return the instrument with its tensors on a device; measurement models follow their states."""
        colour = None if self.colour is None else Colour(*(part.to(device) for part in self.colour))
        plain = {name: part.to(device) for name, part in self._asdict().items() if isinstance(part, Tensor)}
        return self._replace(**plain, colour=colour)


class Segment(NamedTuple):
    """Batch of measurement segments with K intervals each and unknown states.

    Attributes:
        values: (B, K + 1, M); NaN where missing; single components may be missing.
        times: (B, K + 1), increasing in each row.
        instrument: instrument of the measurements.
    """

    values: Tensor
    times: Tensor
    instrument: Instrument

    @property
    def measured(self) -> Tensor:
        """Number of measured values in each segment, (B,)."""
        return (~self.values.isnan()).sum((1, 2))

    def to(self, device: torch.device) -> Segment:
        """Return the segments and their instrument on a device."""
        return Segment(self.values.to(device), self.times.to(device), self.instrument.to(device))

    def first(self, intervals: int) -> Segment:
        """Return the segments truncated to their first intervals."""
        values, times = self.values[:, : intervals + 1], self.times[:, : intervals + 1]
        return self._replace(values=values, times=times)

    def rows(self, part: slice | Tensor) -> Segment:
        """Return selected segments."""
        return self._replace(values=self.values[part], times=self.times[part])

    def residuals(self, states: Tensor) -> Tensor:
        """Return predicted - measured in standard deviations, (B, K + 1, M), 0 where missing.

        Args:
            states: (B, K + 1, D) predicted states at the measurement times.
        """
        measurement, bias = self.instrument.measurement, self.instrument.bias
        predicted = measurement(states, self.times)
        predicted = predicted if bias is None else predicted + bias.to(predicted)
        difference = -residual(measurement, self.values, predicted)
        scaled = difference / self.instrument.deviations.to(states)
        return torch.where(self.values.isnan(), torch.zeros_like(scaled), scaled)

    @property
    def whitening(self) -> Whitening | None:
        """Whitening of coloured residuals; None for white ones."""
        colour = self.instrument.colour
        return None if colour is None else Whitening.of(colour, self.times, ~self.values.isnan())

    def white_residuals(self, states: Tensor) -> Tensor:
        """Return `residuals`, whitened if their noise is coloured, (B, K + 1, M)."""
        whitening, rows = self.whitening, self.residuals(states)
        return rows if whitening is None else whitening(rows)

    def scores(self, states: Tensor) -> Tensor:
        """Return white residuals that are normal where the noise is as stated, (B, K + 1, M)."""
        rows, freedom = self.white_residuals(states), self.instrument.freedom
        return rows if freedom is None else normal_scores(rows, freedom)
