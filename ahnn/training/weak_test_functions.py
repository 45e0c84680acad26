"""Test functions over spans of samples, their integrals, and the noise of the integrals."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

POWER = 8
"""Exponent p of phi = (1 - u^2)^p: derivatives below order p vanish at its ends, so sums equal integrals."""
NARROWEST = {1: 10, 2: 6}
"""Minimum number of samples in half a span, by the order of the equation: with fewer, sums differ from
integrals, however small the noise. Measured positions (order 2) are sparse, and wide spans would smooth out
regions of large forces.
"""
DEGREE = 7
"""Degree up to which sums over finitely many samples are exact for polynomials."""
PER_WIDTH = 3
"""Number of test functions that begin within half a span."""
UNEVEN = 3.0
"""Ratio of neighbouring steps beyond which linear interpolation replaces a parabola."""


class Tests(NamedTuple):
    """Test functions of segments, multiplied by quadrature weights.

    Attributes:
        stride: number of samples between the beginnings of neighbouring spans.
        on_field: phi over its span of S samples, (B, J, S); B may be 1 if common to all.
        on_data: -(-1)^k times the k-th derivative of phi, (B, J, S), for an equation of order k.
        there: (B, J) bool, whether no sample of the span is missing.
    """

    stride: int
    on_field: Tensor
    on_data: Tensor
    there: Tensor

    def rows(self, part: slice) -> Tests:
        """Return the test functions of selected segments."""
        if len(self.on_field) == 1:
            return self
        return Tests(self.stride, self.on_field[part], self.on_data[part], self.there[part])

    def covariances(self, size: int, rates: Tensor | None = None) -> list[Tensor]:
        """Return the covariances of sums over overlapping spans, closest first, for `BandedFactor.of`.

        Noise n of the samples changes a sum by phi' n + phi J n, or by -phi'' n + phi J n for a second-order
        equation, with J the derivative of its right-hand side: noise of a momentum also affects the position
        equation (Bortz, Messenger & Dukic 2023, Bull. Math. Biol. 85, 110). A sum with a missing sample has
        no noise.

        Args:
            size: number D of components of a sample.
            rates: J in units of the noise of each component, (B, K + 1, D, D); None to omit it.
        """
        count, reach = self.on_field.shape[1:]
        one = torch.eye(size).to(self.on_data)
        found = []
        for distance in range(min(count, (reach - 1) // self.stride + 1)):
            shift = distance * self.stride
            field, data = (of[:, distance:, : reach - shift] for of in (self.on_field, self.on_data))
            field_before, data_before = (
                of[:, : count - distance, shift:] for of in (self.on_field, self.on_data)
            )
            band = (data * data_before).sum(-1)[..., None, None] * one
            if rates is not None:
                for weights, samples in (
                    (field * data_before, rates),
                    (data * field_before, rates.mT),
                    (field * field_before, rates @ rates.mT),
                ):
                    flat = integrated(weights, self.stride, samples[:, shift:].flatten(2))
                    band = band + flat.unflatten(-1, (size, size))
            both = self.there[:, distance:] & self.there[:, : count - distance]
            found.append(band * both[..., None, None])
        return found


def integrated(weights: Tensor, stride: int, samples: Tensor) -> Tensor:
    """Return the sums over each span of weights (B, J, S) times samples (B, K + 1, M), shape (B, J, M).

    Span j begins at sample j x stride.
    """
    reach = stride * (weights.shape[1] - 1) + 1
    total = weights[..., :1].to(samples) * samples[:, :reach:stride]
    for offset in range(1, weights.shape[-1]):
        of_each = samples[:, offset : offset + reach : stride]
        total.addcmul_(weights[..., offset, None].to(samples), of_each)
    return total


def bumps(times: Tensor, present: Tensor, width: int, order: int = 1) -> Tests:
    """Build test functions over spans of 2 x width intervals, or over all intervals if there are fewer.

    Args:
        times: (B, K + 1) sample times.
        present: (B, K + 1) bool, whether a sample is present.
        width: half of a span, in samples, at least `NARROWEST` if the data suffice.
        order: order k of the equation, 1 or 2.
    """
    last = times.shape[1] - 1
    width = max(1, min(max(width, NARROWEST[order]), last // 2))
    stride = max(1, width // PER_WIDTH)
    begins = torch.arange(0, last - 2 * width + 1, stride, device=times.device)
    spans = begins.unsqueeze(-1) + torch.arange(2 * width + 1, device=times.device)
    of_span = times[:, spans]
    half = (of_span[..., -1:] - of_span[..., :1]) / 2
    u = ((of_span - of_span[..., :1]) / half - 1).clamp(-1, 1)
    weights, bump = quadrature(times)[:, spans], 1 - u * u
    on_field = weights * bump**POWER
    on_data = weights * _derivative(u, bump, order) / half**order
    on_data = on_data + _correction(on_field, on_data, u, half, order)
    missing = ((on_field != 0) & ~present[:, spans]).any(-1)
    return Tests(stride, on_field, on_data, ~missing)


def _correction(on_field: Tensor, on_data: Tensor, u: Tensor, half: Tensor, order: int) -> Tensor:
    """Return the correction that makes sums exact for polynomials x(t) up to `DEGREE`.

    It is the smallest such correction, small where phi is small. Without it, a large mean position would
    contribute to sums over spans with few samples.
    """
    degree = min(DEGREE, u.shape[-1] - 3)
    power = torch.arange(degree + 1).to(u)
    factor = power if order == 1 else power * (power - 1)
    basis = u.unsqueeze(-1) ** power
    derivatives = factor * u.unsqueeze(-1) ** (power - order).clamp(min=0) / half.unsqueeze(-1) ** order
    left = (on_field.unsqueeze(-1) * derivatives + on_data.unsqueeze(-1) * basis).sum(-2)
    near = basis * ((1 - u * u) ** (POWER // 2)).unsqueeze(-1)
    return -(near @ torch.linalg.solve(basis.mT @ near, left.unsqueeze(-1))).squeeze(-1)


def _derivative(u: Tensor, bump: Tensor, order: int) -> Tensor:
    """Return d phi/du, or -d^2 phi/du^2, of phi = bump^p with bump = 1 - u^2."""
    slope = -2 * POWER * u * bump ** (POWER - 1)
    if order == 1:
        return slope
    return 2 * POWER * bump ** (POWER - 2) * (bump - 2 * (POWER - 1) * u * u)


def quadrature(times: Tensor) -> Tensor:
    """Return quadrature weights (B, K + 1) for functions that vanish at and beyond both ends.

    Simpson's rule over every pair of neighbouring steps, halved. For equal steps all weights are equal, and
    sums of smooth functions are exact to high order; for unequal steps the trapezoidal rule would be of
    second order only.
    """
    steps = times.diff(dim=1)
    steps = torch.cat((steps[:, :1].expand(-1, 2), steps, steps[:, -1:].expand(-1, 2)), dim=1)
    a, b = steps[:, :-1], steps[:, 1:]
    left = a * (2 * a + 3 * b) - b**3 / a
    right = b * (2 * b + 3 * a) - a**3 / b
    uneven = torch.maximum(a / b, b / a) > UNEVEN
    left, right = (
        torch.where(uneven, own / 2, found / (6 * (a + b))) for own, found in ((a, left), (b, right))
    )
    middle = a + b - left - right
    return (left[:, 2:] + middle[:, 1:-1] + right[:, :-2]) / 2
