"""Several simultaneous instruments, such as the stations of a network."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import torch
from torch import Tensor

from ahnn.measurements.angles import periods, residual
from ahnn.measurements.base import Locating, Measurement, Sighted, Time


class Several:
    """Concatenated measurements of several models, each with its own field of view.

    Args:
        models: at least one; component names are prefixed with the number of the model, from 1.

    Raises:
        ValueError: there is no model.
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
        """Return the mask of measured components at states x (..., D), (..., M) bool."""
        views = [
            model.in_view(x, t)
            if isinstance(model, Sighted)
            else torch.ones(*x.shape[:-1], size, dtype=torch.bool)
            for model, size in zip(self.models, self.sizes, strict=True)
        ]
        return torch.cat(views, dim=-1)

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred, each part as defined by its model."""
        parts = zip(self.models, y.split(self.sizes, -1), y_pred.split(self.sizes, -1), strict=True)
        return torch.cat([residual(model, a, b) for model, a, b in parts], dim=-1)

    def locate(self, y: Tensor, t: Time) -> Tensor:
        """Return the mean of the positions (..., n) estimated from y (..., M); NaN if there are none."""
        parts = zip(self.models, y.split(self.sizes, -1), strict=True)
        located = [cast(Any, model).locate(part, t) for model, part in parts if isinstance(model, Locating)]
        return torch.stack(located).nanmean(0)
