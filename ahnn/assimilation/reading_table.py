"""Readings of many objects as columns, and the estimates after them."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ahnn.assimilation.stream_estimate import Outcome

Fate = Outcome | Literal["bad", "lost", "unknown"]
"""Outcomes of a reading: as for one object, or no finite estimate, lost object, or unknown object."""
FATES: tuple[Fate, ...] = (
    *("taken", "reopened", "rejected", "predicted", "repeated", "late", "ahead"),
    *("bad", "lost", "unknown"),
)
"""Outcomes in the order of their codes."""
COUNTED = 4
"""Number of leading outcomes for which an output row is written."""

Array = NDArray[np.float64]
Places = NDArray[np.int64]


class ReadingTable(NamedTuple):
    """Table of K readings.

    Attributes:
        objects: names of the measured objects.
        times: (K,) times in the unit of the space.
        sensors: (K,) sensor indices, -1 for a request for a prediction.
        values: (K, W) values in the columns of all sensors, NaN where missing.
        deviations: (K, W) standard deviations, NaN: as set for the sensor.
    """

    objects: list[str]
    times: Array
    sensors: Places
    values: Array
    deviations: Array


class CatalogueEstimates(NamedTuple):
    """Estimates of the measured object after each of K readings.

    Attributes:
        fates: (K,) indices in `FATES`.
        times: (K,) times of the estimates; NaN for unknown objects, as are means and covariances.
        means: (K, D) state estimates.
        covariances: (K, D, D) covariances.
        residuals: (K, W) measurement minus prediction, NaN where missing, as are deviations and NIS.
        deviations: (K, W) standard deviations of the residuals.
        nis: (K,) normalised innovation squared.
        measured: (K,) number of measured values.
        replayed: (K,) number of later readings that were replayed.
        reasons: reason for each lost object or invalid measurement, by reading index.
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
        """Allocate estimates of readings not yet processed."""
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
        """Outcomes of the readings in words."""
        return [FATES[k] for k in self.fates.tolist()]

    @property
    def counted(self) -> NDArray[np.bool_]:
        """(K,) mask of processed readings, for which an output row is written."""
        return self.fates < COUNTED


def rounds(numbers: Places) -> list[Places]:
    """Split readings into rounds that contain each object at most once, preserving the order per object.

    Args:
        numbers: (K,) object indices; readings with -1 are omitted.
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
