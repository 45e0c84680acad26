"""Tracking measurements that an orbit is fitted to, in standard deviations of their noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class WhitenedRows(NamedTuple):
    """Whitened fitted measurements, one per row.

    Attributes:
        e: residuals in standard deviations, (M,).
        by: negative derivatives with respect to the free unknowns, (M, F).
        group: index of the noise, station * 6 + kind, (M,).
        sd: noise standard deviation, (M,).
    """

    e: Array
    by: Array
    group: NDArray[np.int64]
    sd: Array
