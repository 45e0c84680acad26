"""What learned dynamics say of times to come: states, how well they are known, and how far from the training."""

from __future__ import annotations

from ahnn.prediction.kernel import Prediction, predicted, together

__all__ = ["Prediction", "predicted", "together"]
