"""Predictions in another inertial frame than that of the model."""

from __future__ import annotations

import torch

from ahnn.data.files.frame_names import known
from ahnn.data.start_frames import matrices_to
from ahnn.data.starts import Starts
from ahnn.errors import UserError
from ahnn.prediction.propagation import Prediction
from ahnn.types import Space


def turned_prediction(
    prediction: Prediction, starts: Starts, frame: str | None, space: Space
) -> tuple[Prediction, Starts]:
    """Transform predicted states and covariances to another frame, and return the starts with its name.

    Args:
        prediction: prediction in the frame of `starts`.
        starts: names, times and reference of the starts; their states are not transformed.
        frame: GCRF or EME2000; None: no transformation.
        space: description of the state components.

    Raises:
        UserError: an unspecified or unknown frame, no epoch, or states that are not three lengths and their
            velocities.
    """
    own = starts.reference
    if frame is None:
        return prediction, starts
    if not known(own.frame):
        received = own.frame or "none. Name the frame of the model with frame="
        message = f"output_frame: expected a model in a frame of docs/frames.md; received {received}"
        raise UserError(message)
    times = starts.times.unsqueeze(1) + prediction.times
    moments, place = times.unique(return_inverse=True)
    turn = matrices_to(frame, own, moments, space, "output_frame")[place]
    states = torch.einsum("btij,btj->bti", turn, prediction.states)
    covariances = prediction.covariances
    if covariances is not None:
        covariances = turn @ covariances @ turn.mT
    samples = prediction.samples
    if samples is not None:
        samples = torch.einsum("btij,btsj->btsi", turn, samples)
    found = prediction._replace(states=states, covariances=covariances, samples=samples)
    return found, starts._replace(reference=own._replace(frame=frame))
