"""A folder as `ahnn.orbit` takes it: measurements of a known orbit, a sidecar and a setup."""

from __future__ import annotations

import numpy as np
import yaml
from earth import EPOCH, LAST, bodies
from simulated import STATIONS, TRUE, data

from ahnn.data.files import epochs
from ahnn.systems.gravity import eigen6s
from ahnn.tracking.accelerations.earth_gravity import EarthGravity
from ahnn.tracking.earth_rotation import EarthRotation
from ahnn.tracking.formats.finals import installed_orientation
from ahnn.tracking.satellite_arc import Forces, satellite_arc
from ahnn.tracking.tracking_model import Corrections, TrackingModel


def true_arc():
    """The known orbit, under gravity of degree 2."""
    rotation = EarthRotation(EPOCH, -LAST, LAST, installed_orientation())
    forces = Forces([EarthGravity(eigen6s().cut(2, 0), rotation)])
    return rotation, satellite_arc(forces, TRUE, np.empty(0), 0.0, -2.0, 2e4)


def orbit_folder(place, biases=(), count=60):
    """Write and return a folder with so many measurements; ranges of stations may have biases, km."""
    rotation, arc = true_arc()
    taken = data(count=count)
    model = TrackingModel(taken, STATIONS, Corrections(), rotation, bodies())
    rng, lines, off = np.random.default_rng(1), [], dict(biases)
    for n, values in enumerate(model(arc).values):
        when = epochs.spelled(EPOCH + round(taken.times[n] * 1e12), utc=True)
        station, noise = taken.stations[taken.station[n]], rng.standard_normal(3)
        lines.append(f"{when} RANGE {station} {values[0] + 0.01 * noise[0] + off.get(station, 0):.9f}")
        angles = np.degrees(values[1:3]) + 0.01 * noise[1:]
        lines.append(f"{when} AZ_EL {station} {angles[0]:.9f} {angles[1]:.9f}")
    (place / "seen.aer").write_text("\n".join(lines) + "\n")
    setup = {
        "measurements": "seen.aer",
        "stations": {
            one.name: [float(np.degrees(one.latitude)), float(np.degrees(one.longitude)), 1e3 * one.height]
            for one in STATIONS
        },
        "start": {
            "epoch": "2016-02-13T16:00:00",
            "position": [float(x) for x in TRUE[:3] + 5.0],
            "velocity": [float(x) for x in TRUE[3:]],
        },
        "forces": {"gravity": {"degree": 2, "order": 0}, "sun": False, "moon": False},
        "noise": {"range": 0.01, "azimuth": 0.01, "elevation": 0.01},
    }
    (place / "seen.yaml").write_text("units: {RANGE: km, AZ_EL: deg}\n")
    (place / "setup.yaml").write_text(yaml.safe_dump(setup))
    return place
