"""Unscented transformation as the kernel of a Gaussian filter."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.kernel import measured, propagate
from ahnn.estimation.results import Predicted, Updated
from ahnn.estimation.rounding import Rounding
from ahnn.measurements import Position, State, nearest, residual
from ahnn.types import Flow
from ahnn_plugins.ukf.parameters import Form, SigmaWeights
from ahnn_plugins.ukf.sigma_points import draw
from ahnn_plugins.ukf.unscented_smoother import backward_kernel

READINGS = (Position, State)
"""Measurement models of the first state components; subclasses may behave differently."""


class SigmaPoints(NamedTuple):
    """Predictions and updates by sigma points.

    Sigma points are redrawn after Q is added, as required for equality with the Kalman filter on a linear
    system.

    Attributes:
        weights: sigma point weights.
        form: form of the covariances.
        points: (B, S, D) propagated points of the next prediction, if already known.
    """

    weights: SigmaWeights
    form: Form
    points: Tensor | None = None

    @property
    def rounding(self) -> Rounding:
        """Amplification of rounding errors by closely spaced points and explicit covariances."""
        return Rounding(self.weights.crowding, self.form.squares, self.weights.downdate is not None)

    def predict(
        self, belief: Belief, flow: Flow, dt: float, chol_q: Tensor, *, smoothing: bool = False
    ) -> Predicted:
        """Propagate the belief over a step; the flow is called once, on B (2 D + 1) points."""
        points = self.points
        if points is None:
            points = propagate(flow, draw(belief, self.weights), dt)
        predicted = self.form.predict(points, self.weights, chol_q)
        if not smoothing:
            return predicted
        backward, mended = backward_kernel(points, belief.chol, self.weights, chol_q)
        if mended is not None and predicted.repaired is not None:
            # The backward kernel contains the predicted covariance, whose repair is not counted twice.
            mended = mended & ~predicted.repaired
        return predicted._replace(backward=backward, mended=mended)

    def update(self, prior: Belief, y: Tensor, sensor: SensorModel, time: float) -> Updated:
        """Condition the belief on a row; measured state components need no points."""
        model, size = sensor.measurement, y.shape[-1]
        if self.form.read is not None and type(model) in READINGS and size <= prior.mean.shape[-1]:
            turned = nearest(model, y, prior.mean[:, :size])
            if (updated := self.form.read(prior, turned, self.weights, sensor.chol_r)) is not None:
                return updated
        images = measured(model, draw(prior, self.weights), time)
        return self.form.update(prior, images, y, partial(residual, model), self.weights, sensor.chol_r)
