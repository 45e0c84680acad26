"""Initial covariances from orbit ephemeris messages."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ahnn.data.files import Ephemeris, read_oem, read_opm
from ahnn.data.files.epochs import SECOND
from ahnn.data.files.kinds import kind_of
from ahnn.data.files.raw import content_of
from ahnn.data.files.samples import Array
from ahnn.data.reference import alias
from ahnn.errors import UserError

log = logging.getLogger("ahnn")

ALONG = ("RTN", "RSW", "RIC")
"""Names of the axes along the position, along-track in the orbital plane, and along the angular momentum."""
MILLISECOND = SECOND // 1000
"""Tolerance within which two epochs are equal."""


class KnownCovariance(NamedTuple):
    """Known covariances of states.

    Attributes:
        matrices: (B, 6, 6), in km and km/s.
        moments: their epochs.
    """

    matrices: Tensor
    moments: list[int]


def covariances_of(path: Path, moments: list[int], *, earlier: bool) -> KnownCovariance | None:
    """Return the covariance of each segment's state; None, with a warning, if a segment lacks one.

    Args:
        path: path of the message.
        moments: epochs of the states.
        earlier: whether to accept the covariance of an earlier state, for propagation.

    Raises:
        UserError: axes that cannot be transformed to the axes of the states.
    """
    segments = (read_opm if kind_of(content_of(path), str(path)) == "opm" else read_oem)(path)
    if not any(one.covariances for one in segments):
        return None
    found = [latest(one, moment, path, earlier) for one, moment in zip(segments, moments, strict=True)]
    if None in found:
        log.warning(
            "start %s: the covariances are not used, since they belong to other epochs than the states", path
        )
        return None
    matrices, at = zip(*(one for one in found if one is not None), strict=True)
    return KnownCovariance(torch.from_numpy(np.stack(matrices)), list(at))


def latest(one: Ephemeris, moment: int, path: Path, earlier: bool) -> tuple[Array, int] | None:
    """Return the last covariance of a segment up to an epoch, and its epoch."""
    for covariance in sorted(one.covariances, key=lambda each: -each.time):
        here = one.start + round(covariance.time * SECOND)
        k = int(np.abs(one.times - covariance.time).argmin())
        fits = here <= moment + MILLISECOND if earlier else abs(here - moment) <= MILLISECOND
        if fits and abs(one.times[k] - covariance.time) * SECOND <= MILLISECOND:
            axes = axes_of(one.states[k], covariance.frame, one, path)
            return axes @ covariance.matrix @ axes.T, here
    return None


def axes_of(state: Array, frame: str, one: Ephemeris, path: Path) -> Array:
    """Return the matrix (6, 6) from the axes of a covariance to the axes of its state; raises UserError."""
    if not frame or alias(frame) == alias(one.frame):
        return np.eye(6)
    if frame.upper() not in ALONG:
        expected = f"a covariance in {one.frame} or {ALONG[0]}"
        message = f"start {path}: expected {expected}; received one in {frame}. Set start_sd= instead"
        raise UserError(message)
    radial, normal = state[:3], np.cross(state[:3], state[3:])
    axes = np.stack((radial, np.cross(normal, radial), normal))
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    return np.kron(np.eye(2), axes.T)
