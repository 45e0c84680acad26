"""Tests of orbits for wrong units or frames, from accelerations derived from positions.

For each hypothesis about unit and frame, the acceleration is compared with mu/r^2; hypotheses differ by
factors, so that at most one fits.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence

import numpy as np

from ahnn.data.doctor.finding import Finding
from ahnn.data.doctor.slopes import slopes
from ahnn.data.files.content import Content
from ahnn.data.files.frame_names import LISTED, ROTATING, is_unknown
from ahnn.data.files.frames import TURN
from ahnn.data.files.samples import Array, Track
from ahnn.data.files.units import LENGTH, TIME, unit
from ahnn.data.reference import Reference

MU = {
    "EARTH": 398600.4418,
    "SUN": 132712440041.9,
    "MOON": 4902.800,
    "MARS": 42828.375,
    "VENUS": 324858.592,
    "JUPITER": 126712764.1,
    "SATURN": 37940584.8,
}
"""Gravitational parameters in km^3/s^2 (JPL DE440)."""
EXACT = 0.02
"""Relative difference of accelerations that is attributed to perturbations."""
FITS = 0.1
"""Maximum difference for another hypothesis; the stated unit and frame must also fit much worse."""
UNCLEAR = 0.15
"""Relative uncertainty of the accelerations above which nothing is reported."""
LENGTHS = {
    1.0: "",
    1e-3: "positions are 1000 times too large (m as km?)",
    1e3: "positions are 1000 times too small (km as m?)",
}
TIMES = {
    1.0: "",
    60.0: "times are 60 times too small (min as s?)",
    3600.0: "times are 3600 times too small (h as s?)",
    1 / 60: "times are 60 times too large (s as min?)",
    1 / 3600: "times are 3600 times too large (s as h?)",
}
"""Correction factors that make a track an orbit, with their meaning."""
PLANAR = 0.03
"""Maximum misfit of two positions that are said to describe an orbit in their plane."""
LOWEST, FARTHEST = 6378.0, 1e6
"""Distances of Earth satellites from its centre, in km."""
PLANE = ({"x", "y"}, {"rx", "ry"}, {"qx", "qy"}, {"posx", "posy"}, {"positionx", "positiony"})
"""Names of two positions of a satellite whose third is missing, in lower case and without underscores."""
TURNS = {False: "positions are in an inertial frame", True: "positions rotate with the Earth"}


def orbit_findings(content: Content, tracks: list[Track]) -> list[Finding]:
    """Find wrong units or frames of orbits; empty for orbits around unknown bodies.

    Args:
        content: content of the file.
        tracks: tracks to be tested.
    """
    length, clock = unit(content.units.position), unit(content.units.time)
    if length.dimension != LENGTH or clock.dimension != TIME:
        return []
    if len(content.positions) != 3:
        return without_height(content, tracks)
    body = next((word for word in words(content.frame) if word in MU), None)
    turning = content.frame.upper().startswith(ROTATING)
    found: list[tuple[Track, str]] = []
    for track in tracks:
        times, positions = clock.size * track.times, length.size / 1000 * track.values[:, :3]
        said = hypothesis(times, positions, body, turning=turning, names=content.positions)
        if said:
            found.append((track, said))
    remedy = "Correct the unit or frame; system.frame converts known frames"
    place, name = content.positions[0], (body or "Earth").capitalize()
    if len(found) > 0.9 * len(tracks):
        found = [(found[0][0]._replace(rows=np.full(1, content.head)), found[0][1])]
    what = f"not an orbit around the {name}"
    return unknown_frame(content) + [
        Finding("fault", track.file, int(track.rows[0]), place, f"{what}: {said}", remedy)
        for track, said in found
    ]


def unknown_frame(content: Content) -> list[Finding]:
    """Return a warning for the name of a frame that cannot be converted, perhaps a misspelled one."""
    frame = Reference.of(content.frame).frame
    if not is_unknown(frame):
        return []
    remedy = f"Known frames: {LISTED}"
    what = f"frame {frame} is unknown: states in it are not converted"
    return [Finding("warning", content.tracks[0].file, content.head, "", what, remedy)]


def without_height(content: Content, tracks: list[Track]) -> list[Finding]:
    """Return a warning for two positions of Earth satellites that do not move in their plane."""
    if {name.lower().replace("_", "") for name in content.positions} not in PLANE:
        return []
    length, clock = unit(content.units.position).size / 1000, unit(content.units.time).size
    given = [(clock * track.times, length * track.values[:, :2]) for track in tracks]
    distances = np.concatenate([np.linalg.norm(q, axis=1) for _, q in given])
    farthest = distances.max(initial=0.0, where=np.isfinite(distances))
    turning = content.frame.upper().startswith(ROTATING)
    plane = (misfit(t, np.pad(q, ((0, 0), (0, 1))), MU.values(), turned=turning) <= PLANAR for t, q in given)
    if not LOWEST < farthest < FARTHEST or any(plane):
        return []
    what = "two positions do not describe an orbit in space: is z missing?"
    remedy = "Add z, and vz to velocities, unless the orbit lies in the plane of both"
    return [Finding("warning", tracks[0].file, content.head, content.positions[-1], what, remedy)]


def words(frame: str) -> list[str]:
    """Split the name of a frame into words."""
    return frame.upper().replace(",", " ").split()


def hypothesis(
    times: Array,
    positions: Array,
    body: str | None,
    *,
    turning: bool,
    names: Sequence[str] = ("x", "y", "z"),
) -> str:
    """Return the unit or frame mistake that explains an orbit (km, s); "" if there is none.

    Args:
        times: (T,) in s.
        positions: (T, 3) in km.
        body: central body; None for any body; mistakes are then tested for Earth orbits.
        turning: whether the stated frame rotates with the Earth.
        names: columns of the positions.
    """
    mu = [MU[body or "EARTH"]]
    here = misfit(times, positions, mu, turned=turning)
    if here <= EXACT or (body is None and misfit(times, positions, MU.values(), turned=turning) <= EXACT):
        return ""
    for turned, length, time in itertools.product((turning, not turning), LENGTHS, TIMES):
        left = misfit(time * times, length * positions, mu, turned=turned)
        if left < min(FITS, here / 3):
            frame = "" if turned == turning else TURNS[turned]
            return " and ".join(filter(None, (LENGTHS[length], TIMES[time], frame)))
    for axis, length in itertools.product(range(3), filter(LENGTHS.get, LENGTHS)):
        scaled = positions * np.where(np.arange(3) == axis, length, 1.0)
        if misfit(times, scaled, mu, turned=turning) < min(FITS, here / 3):
            return LENGTHS[length].replace("positions are", f"{names[axis]} is")
    return ""


def misfit(times: Array, positions: Array, bodies: Collection[float], *, turned: bool) -> float:
    """Return the relative misfit of accelerations to mu/r^2; infinite if undetermined.

    Args:
        times: (T,), s.
        positions: (T, 3), km.
        bodies: values of mu in km^3/s^2; the best one is used.
        turned: whether to transform the positions from an Earth-fixed frame first.
    """
    if turned:
        c, s = np.cos(TURN * times), np.sin(TURN * times)
        x, y, z = positions.T
        positions = np.stack((c * x - s * y, s * x + c * y, z), axis=1)
    found = slopes(times, positions, 2)
    if found is None or found.doubt > UNCLEAR:
        return math.inf
    here = positions[found.at]
    radius = np.linalg.norm(here, axis=1, keepdims=True)
    known = np.isfinite(found.values).all(1) & (radius[:, 0] > 0)
    here, radius, acceleration = here[known], radius[known], found.values[known]
    if not len(here):
        return math.inf
    left = [np.linalg.norm(acceleration * radius**2 / mu + here / radius, axis=1) for mu in bodies]
    return min(float(np.median(one)) for one in left)
