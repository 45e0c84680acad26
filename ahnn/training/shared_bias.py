"""Constant sensor biases, common to all segments, eliminated from normal equations like initial states.

With K biases b in addition to the parameters, normal equations have the blocks (A, C; C^T, B) and gradients
(g, h). A normal prior adds its precision to B, S = B + diag(1 / sd^2), and the corresponding term to h. The
best b for given parameters is b - S^-1 h. The reduced equations of the parameters have the matrix A - C S^-1
C^T, the gradient g - C S^-1 h, and a sum of squares that is less by h^T S^-1 h (Tapley, Schutz & Born 2004,
section 6.4). An unobservable bias makes the parameters uncertain by as much as its prior allows.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.measurements import Instrument, Segment
from ahnn.training.normal_equations import Block, Equations


class SharedBias(NamedTuple):
    """Linearised model of K biases.

    Attributes:
        places: indices of the components with a bias, (K,).
        value: b, (K,), in the units of the measurements.
        precision: precision of the prior about zero, (K,).
        matrix: S, (K, K).
        coupling: C, (P, K), of P parameters.
    """

    places: Tensor
    value: Tensor
    precision: Tensor
    matrix: Tensor
    coupling: Tensor

    def gain(self, pull: Tensor) -> Tensor:
        """Return the decrease of the sum of squares, including the prior, by the best biases, from h (K,)."""
        return pull @ torch.linalg.solve(self.matrix, pull) - self.precision @ self.value.square()

    def gradient(self, gradient: Tensor, pull: Tensor) -> Tensor:
        """Return the reduced gradient (P,) from g (P,) and h (K,)."""
        return gradient - self.coupling @ torch.linalg.solve(self.matrix, pull)

    def best(self, pull: Tensor, factor: Tensor, inflation: float) -> tuple[Tensor, Tensor]:
        """Return the best biases and their standard deviations, (K,) each.

        Args:
            pull: h, (K,).
            factor: L, (P, R); L L^T is the covariance of the parameters.
            inflation: factor on the covariance.
        """
        inverse = torch.linalg.inv(self.matrix)
        through = inverse @ self.coupling.mT @ factor
        variance = inverse.diagonal() + through.square().sum(1)
        return self.value - inverse @ pull, (inflation * variance).sqrt()


def unknown_places(instrument: Instrument) -> Tensor:
    """Return the indices of the components with an unknown bias, (K,)."""
    sd = instrument.bias_sd
    return torch.zeros(0, dtype=torch.int64) if sd is None else (sd > 0).nonzero().squeeze(-1)


def of_biases(segment: Segment) -> Tensor:
    """Return the derivative of each white residual with respect to the bias of its component, (B, T, M)."""
    there = ~segment.values.isnan()
    rows, whitening = there / segment.instrument.deviations, segment.whitening
    return rows if whitening is None else whitening(rows)


def columns_of(of_bias: Tensor, instrument: Instrument) -> Tensor:
    """Return the derivatives of residuals with respect to K biases, (B, T, M, K), from `of_biases`."""
    return torch.diag_embed(of_bias)[..., unknown_places(instrument)]


def pull_of(rows: Tensor, segment: Segment) -> Tensor:
    """Return h, (K,), from weighted residuals (B, T, M) for the best initial states."""
    places, (value, precision) = unknown_places(segment.instrument), prior(segment.instrument)
    return (rows * of_biases(segment)).sum((0, 1))[places] + precision * value


def prior(instrument: Instrument) -> tuple[Tensor, Tensor]:
    """Return the biases already subtracted, (K,), and the precision (K,) of their prior about zero."""
    places = unknown_places(instrument)
    assert instrument.bias_sd is not None
    value = instrument.bias_sd.new_zeros(len(instrument.bias_sd))
    value = value if instrument.bias is None else instrument.bias
    return value[places], instrument.bias_sd[places] ** -2


def eliminated(found: Equations, instrument: Instrument) -> tuple[Equations, SharedBias]:
    """Return the reduced equations of the parameters; the biases are the last columns of `found`."""
    (block,), places = found.blocks, unknown_places(instrument)
    value, precision = prior(instrument)
    size = len(block.gradient) - len(places)
    matrix, coupling = block.matrix[:size, :size], block.matrix[:size, size:]
    pull = block.gradient[size:] + precision * value
    own = block.matrix[size:, size:] + precision.diag()
    shared = SharedBias(places, value, precision, own, coupling)
    left = matrix - coupling @ torch.linalg.solve(own, coupling.mT)
    gradient = shared.gradient(block.gradient[:size], pull)
    loss = found.loss - shared.gain(pull)
    return Equations(loss, found.degrees, [Block(block.columns[:size], left, gradient)]), shared


def spread_over(values: Tensor, places: Tensor, size: int) -> Tensor:
    """Return values (K,) at their places among M components, zeros elsewhere."""
    return values.new_zeros(size).index_copy(0, places, values)
