"""Readings of many objects as columns, and the estimates after them."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ahnn.assimilation.online import Outcome

Fate = Outcome | Literal["bad", "lost", "unknown"]
"""What became of a reading: as of one object, or it left no finite estimate, its object is lost, or there is
no such object."""
FATES: tuple[Fate, ...] = (
    *("taken", "reopened", "rejected", "predicted", "repeated", "late", "ahead"),
    *("bad", "lost", "unknown"),
)
"""In the order of the numbers that stand for them."""
COUNTED = 4
"""Of so many at the front a row goes out."""

Array = NDArray[np.float64]
Places = NDArray[np.int64]


class ReadingTable(NamedTuple):
    """K readings.

    Attributes:
        objects: names of what was measured.
        times: (K,) in the unit of the space.
        sensors: (K,) their numbers, -1 of a reading that asks for a prediction.
        values: (K, W) in the columns of all sensors, NaN where a number is missing.
        deviations: (K, W) standard deviations, NaN for those of the sensor.
    """

    objects: list[str]
    times: Array
    sensors: Places
    values: Array
    deviations: Array


class CatalogueEstimates(NamedTuple):
    """What is believed after each of K readings of its object.

    Attributes:
        fates: (K,) places in `FATES`.
        times: (K,) at which the estimates hold; NaN of unknown objects, as all that follows.
        means: (K, D).
        covariances: (K, D, D).
        residuals: (K, W) measurement less prediction, NaN where nothing is told, as in the next three.
        deviations: (K, W) standard deviations of the residuals.
        nis: (K,) normalised innovation squared.
        measured: (K,) numbers that are there.
        replayed: (K,) readings that came before it and are later than it.
        reasons: by the number of the reading why an object was lost by it, or is no measurement.
    """

    fates: NDArray[np.int8]
    times: Array
    means: Tensor
    covariances: Tensor
    residuals: Tensor
    deviations: Tensor
    nis: Tensor
    measured: Tensor
    replayed: Places
    reasons: dict[int, str]

    @classmethod
    def unknown(cls, count: int, size: int, width: int) -> CatalogueEstimates:
        """Return those of so many readings of which nothing is known yet."""
        nothing = torch.full((count,), torch.nan, dtype=torch.float64)
        wide = nothing[:, None].expand(count, width)
        return cls(
            fates=np.full(count, FATES.index("unknown"), dtype=np.int8),
            times=np.full(count, np.nan),
            means=nothing[:, None].repeat(1, size),
            covariances=nothing[:, None, None].repeat(1, size, size),
            residuals=wide.clone(),
            deviations=wide.clone(),
            nis=nothing.clone(),
            measured=torch.zeros(count, dtype=torch.int64),
            replayed=np.zeros(count, dtype=np.int64),
            reasons={},
        )

    @property
    def outcomes(self) -> list[Fate]:
        """Words for what became of the readings."""
        return [FATES[k] for k in self.fates.tolist()]

    @property
    def counted(self) -> NDArray[np.bool_]:
        """(K,) which of them changed an estimate, or asked for a prediction."""
        return self.fates < COUNTED


def rounds(numbers: Places) -> list[Places]:
    """Return readings in rounds, of which each has an object once and in which its readings keep their order.

    Args:
        numbers: (K,) of the objects; readings of -1 are left out.
    """
    order = np.argsort(numbers, kind="stable")
    order = order[np.searchsorted(numbers[order], 0) :]
    if not len(order):
        return []
    own = numbers[order]
    first = np.flatnonzero(np.concatenate(([True], own[1:] != own[:-1])))
    rank = np.arange(len(own)) - np.repeat(first, np.diff(np.append(first, len(own))))
    counts = np.bincount(rank)
    return np.split(order[np.argsort(rank, kind="stable")], np.cumsum(counts)[:-1])
