"""Reference and first epoch of a prediction, as one line for readers."""

from __future__ import annotations

from ahnn.data.starts import Starts
from ahnn.prediction.durations import picoseconds
from ahnn.prediction.propagation import Prediction


def beginning(prediction: Prediction, starts: Starts, unit: str, before_zero: str = " ") -> str:
    """Return frame, centre, time scale and first epoch of the first trajectory.

    Times of the table are relative to time zero, which is named too if the prediction starts at another time.

    Args:
        prediction: prediction from the starts.
        starts: times and reference of the starts.
        unit: unit of time.
        before_zero: white space before the time zero.
    """
    reference = starts.reference
    named = reference._replace(epoch=None).described()
    if reference.epoch is None:
        return named
    first = picoseconds(float(starts.times[0]) + float(prediction.times[0]), unit)
    zero = f"{before_zero}(time zero {reference.spelled()})" if first else ""
    return f"{named}, from {reference.spelled(first)}{zero}"
