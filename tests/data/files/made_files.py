"""Orbits and tables that tests of files share."""

from __future__ import annotations

import numpy as np
import pytest

from ahnn.data.files.reading import FileReading, bytes_of, parsed
from ahnn.errors import UserError

ORBIT = ["x [km]", "y [km]", "z [km]", "vx [km/s]", "vy [km/s]", "vz [km/s]"]


def orbit(count=40, radius=7000.0, step=60.0):
    """A circular orbit inclined by 50 degrees: times, and states in km and km/s."""
    t, rate = step * np.arange(count), np.sqrt(398600.4418 / radius**3)
    c, s, ci, si = np.cos(rate * t), np.sin(rate * t), np.cos(0.87), np.sin(0.87)
    q = radius * np.stack((c, s * ci, s * si), axis=1)
    return t, np.hstack((q, radius * rate * np.stack((-s, c * ci, c * si), axis=1)))


def csv_of(header, rows):
    return "\n".join([",".join(header), *(",".join(map(str, row)) for row in rows)]) + "\n"


def said(path, frame=None):
    """The content of a file, and all that is remarked on or noted."""
    notes = []
    return parsed(path, *bytes_of(path), FileReading(frame=frame), notes.append), notes


def refused(path):
    with pytest.raises(UserError) as caught:
        parsed(path, *bytes_of(path), FileReading())
    return str(caught.value)
