"""Several instruments that measure at the same times, such as the stations of a network."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import torch
from torch import Tensor

from ahnn.measurements.angles import periods, residual
from ahnn.measurements.base import Locating, Measurement, Sighted, Time


class Several:
    """The measurements of several models side by side, NaN of those that do not see the state.

    Args:
        models: at least one; names get the number of their model, counted from 1, in front.

    Raises:
        ValueError: no model.
    """

    def __init__(self, models: Sequence[Measurement]) -> None:
        if not models:
            message = "Several: expected at least one measurement model; received none"
            raise ValueError(message)
        self.models = list(models)
        self.sizes = [len(model.names) for model in self.models]
        self.names = tuple(f"{k}.{name}" for k, model in enumerate(self.models, 1) for name in model.names)
        self.units = tuple(unit for model in self.models for unit in model.units)
        self.periods = tuple(period for model in self.models for period in periods(model))

    def __call__(self, x: Tensor, t: Time) -> Tensor:
        """Return the measurements (..., M) of the states x (..., D), in view or not."""
        return torch.cat([model(x, t) for model in self.models], dim=-1)

    def in_view(self, x: Tensor, t: Time) -> Tensor:
        """Return which of the M numbers are measured of the states x (..., D), (..., M) bool."""
        views = [
            model.in_view(x, t)
            if isinstance(model, Sighted)
            else torch.ones(*x.shape[:-1], size, dtype=torch.bool)
            for model, size in zip(self.models, self.sizes, strict=True)
        ]
        return torch.cat(views, dim=-1)

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred, each part as its model takes differences."""
        parts = zip(self.models, y.split(self.sizes, -1), y_pred.split(self.sizes, -1), strict=True)
        return torch.cat([residual(model, a, b) for model, a, b in parts], dim=-1)

    def locate(self, y: Tensor, t: Time) -> Tensor:
        """Return the mean of the positions (..., n) that y (..., M) are read as; NaN where none is."""
        parts = zip(self.models, y.split(self.sizes, -1), strict=True)
        located = [cast(Any, model).locate(part, t) for model, part in parts if isinstance(model, Locating)]
        return torch.stack(located).nanmean(0)
