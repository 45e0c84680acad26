"""An Earth of some days that tests share: orientation in numbers made up, of the size of real ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ahnn.data.files import epochs
from ahnn.tracking.earth_rotation import EarthRotation
from ahnn.tracking.formats.bulletin_b import EarthOrientation
from ahnn.tracking.sun_and_moon import sun_and_moon

REAL = Path(__file__).parents[2].parent / "shared" / "real"
EPOCH = epochs.instant("2016-02-13T16:00:00", utc=True)
DAYS = np.arange(57428.0, 57440.0)
STILL = np.zeros_like(DAYS)
LAST = 86400.0


def orientation(*, offsets=0.0):
    """Return days of one UT1 - UTC, one pole and one offset of the celestial pole, arcseconds."""
    pole = np.full((len(DAYS), 2), offsets)
    return EarthOrientation(DAYS, STILL + 0.02, STILL + 0.39, STILL + 0.017, pole, STILL == 0)


def rotation(**options):
    return EarthRotation(EPOCH, -LAST, LAST, orientation(**options))


def bodies():
    return sun_and_moon(EPOCH, -LAST, LAST)
