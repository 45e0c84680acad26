"""What learned dynamics say of times to come: states, how well they are known, and how novel they are."""

from __future__ import annotations

from ahnn.prediction.propagation import Prediction, predicted, together

__all__ = ["Prediction", "predicted", "together"]
