"""Variances of forecasts, and the coverage of calibrated bands over draws of noise and parameters."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.evaluation.bands import SIGMAS
from ahnn.uncertainty import largest_displacement

DRAWS, MIDDLE = 200, 0.95
"""Number of draws for the coverage of calibrated bands, and the central fraction reported."""


class Variances(NamedTuple):
    """Variances of forecasts.

    Attributes:
        states: variances of states, (B, K + 1, D).
        parameters: contribution of the parameters to these variances.
        values: variances of measured values, (B, K + 1, M), in units of the noise variance and without noise;
            0 where missing.
        moves: displacements of the states by one standard deviation of the cause with the largest effect on
            the last state, (B, K + 1, D).
        noise: columns (B, D, D) of the noise of the fitted measurements at the time `begin`.
        moved: columns (B, D, R) of the parameters at that time.
        within: number of predicted states within 1, 2 and 3 standard deviations in each draw of noise and
            parameters, (3, DRAWS).
    """

    states: Tensor
    parameters: Tensor
    values: Tensor
    moves: Tensor
    noise: Tensor
    moved: Tensor
    within: Tensor

    @classmethod
    def of(
        cls,
        causes: Iterable[tuple[Tensor, Tensor]],
        of_state: Tensor,
        there: Tensor,
        columns: int,
        begin: int = 0,
    ) -> Variances:
        """Compute variances from the columns of `forecast_columns`.

        Args:
            causes: pairs of noise and parameter columns, as returned by `forecast_columns`.
            of_state: derivatives of measurements, (B, K + 1, M, D).
            there: mask of states counted in `within`, (B, K + 1, D).
            columns: number of parameter columns.
            begin: index of the time whose columns are kept.
        """
        parts, within, count = [], torch.zeros(len(SIGMAS), DRAWS, dtype=torch.int64), 0
        draws = imagined(columns + there[:, 0].numel())
        together, apart = draws[:columns], draws[columns:].view(len(there), 1, -1, DRAWS)
        for noise, moved in causes:
            rows, count = slice(count, count + len(noise)), count + len(noise)
            covariance = noise @ noise.mT + moved @ moved.mT
            of_states = covariance.diagonal(dim1=-2, dim2=-1)
            values = ((of_state[rows] @ covariance) * of_state[rows]).sum(-1)
            both = torch.cat((noise, moved), dim=-1)
            moves = torch.einsum("bkdr,br->bkd", both, largest_displacement(both[:, -1]))
            parts.append((of_states, moved.square().sum(-1), values, moves, noise[:, begin], moved[:, begin]))
            for k, own in enumerate(there[rows], start=rows.start):
                j = k - rows.start
                off = moved[j].float() @ together + noise[j].float() @ apart[k]
                within += held(off[own], of_states[j][own].sqrt().float().unsqueeze(-1))
        states, parameters, values, moves, *first = (torch.cat(part) for part in zip(*parts, strict=True))
        return cls(states, parameters, values, moves, first[0], first[1], within)


def imagined(columns: int) -> Tensor:
    """Return `DRAWS` draws of independent causes, in their standard deviations, (columns, DRAWS)."""
    return torch.randn(columns, DRAWS, generator=torch.Generator().manual_seed(0))


def held(off: Tensor, sd: Tensor) -> Tensor:
    """Return how many of the errors (n, DRAWS) lie within each band in each draw, shape (3, DRAWS).

    Bands are multiples of the standard deviations (n, 1). Errors of one training run are correlated: if
    nearly all lie along one direction, a calibrated band contains either nearly all or few of them.
    """
    return torch.stack([(off.abs() <= k * sd).sum(0) for k in SIGMAS])


def middle(fractions: Tensor) -> tuple[tuple[float, float], ...]:
    """Return the ends of the middle 95 % of fractions (3, DRAWS)."""
    ends = torch.tensor([(1 - MIDDLE) / 2, (1 + MIDDLE) / 2], dtype=torch.float64)
    return tuple(
        (float(low), float(high)) for low, high in torch.quantile(fractions.double(), ends, dim=1).mT
    )
