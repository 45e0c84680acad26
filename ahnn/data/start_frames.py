"""Transformation of initial states of satellites, and of their covariances, to the frame of a model."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ahnn.data.files.content import Content
from ahnn.data.files.frames import turned
from ahnn.data.files.samples import Track
from ahnn.data.files.units import factor, unit
from ahnn.data.reference import Reference
from ahnn.errors import UserError
from ahnn.labels import require_velocities
from ahnn.types import Space


def matrices_to(frame: str, own: Reference, times: Tensor, space: Space, who: str) -> Tensor:
    """Return the matrices (B, 6, 6) that transform states from their own frame to another.

    Args:
        frame: GCRF, EME2000, TEME or CIRS.
        own: reference of the states.
        times: (B,) times of the states.
        space: description of the state components.
        who: description of the states, for messages.

    Raises:
        UserError: no epoch, or states that are not three lengths and their velocities.
    """
    require_velocities(space, who)
    if own.epoch is None:
        expected = f"an epoch, with which states in {own.frame} are transformed to {frame}"
        message = f"{who}: expected {expected}; received none. Add it"
        raise UserError(message)
    names, size = space.components, len(space.components)
    columns = np.tile(np.eye(size), (len(times), 1))  # the images of unit vectors are columns of the matrix
    moments = np.repeat(unit(space.units.time).size * times.numpy(), size)
    images = Track("", who, np.zeros(len(columns), np.int64), moments, columns)
    seconds = space.units._replace(time="s", velocity=f"{space.units.position}/s")
    about = seconds, str(own._replace(epoch=None)), (images,), own.epoch, own.clock or "UTC"
    (track,) = turned(Content(names[: space.dof], names[space.dof :], False, *about), frame, who).tracks
    matrices = torch.from_numpy(track.values).reshape(len(times), size, size).mT
    scales = space.scales.clone()
    scales[space.dof :] /= factor(space.units.velocity, seconds.velocity)
    return scales[:, None] * matrices / scales
