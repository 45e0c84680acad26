"""Accelerations along the reference orbit by terms of the gravity field (figure 4)."""

from __future__ import annotations

import dataclasses
import math

import torch
from torch import Tensor

from ahnn.systems.gravity import GravityField, ggm05c
from ahnn_plugins.report.drawing import Drawing, Panel
from ahnn_plugins.report.figures.curves import curve

ALTITUDE, ECCENTRICITY, INCLINATION = 550.0, 0.75, 63.4
"""Reference orbit: periapsis altitude in km, eccentricity, inclination in degrees; node 0, periapsis 270."""
SAMPLES = 721


def acceleration_drawing() -> Drawing:
    """Plot the magnitudes of accelerations over the true anomaly."""
    anomaly = torch.linspace(-180.0, 180.0, SAMPLES, dtype=torch.float64)
    field = ggm05c()
    q = reference_orbit(anomaly, field.radius)
    altitude = {"altitude [km]": q.norm(dim=-1) - field.radius}
    series = []
    for slot, (name, part) in enumerate(terms(field).items()):
        size = part.attraction(q).norm(dim=-1)
        role = "truth" if slot == 0 else "term"
        line = curve(name, anomaly, size, role=role, slot=slot, log=True)
        series.append(line._replace(hover=altitude) if len(line.x) == len(anomaly) else line)
    caption = (
        f"{field.name} to degree and order {field.degree}, along an orbit of eccentricity {ECCENTRICITY:g}, "
        f"periapsis altitude {ALTITUDE:g} km, inclination {INCLINATION:g}° and argument of periapsis 270°; "
        "the axes of the body and of the orbit's frame coincide. Tesserals: all terms of order above 0."
    )
    panel = Panel(tuple(series), "true anomaly [°]", "acceleration [km/s²]", log=True)
    title = "Accelerations along the reference orbit (as in figure 4 of the paper)"
    return Drawing("perturbing_accelerations", title, caption, (panel,))


def reference_orbit(anomaly: Tensor, radius: float) -> Tensor:
    """Return positions (T, 3) in km at true anomalies (T,) in degrees, about a body of given radius in km."""
    nu, i = torch.deg2rad(anomaly), math.radians(INCLINATION)
    semi_latus_rectum = (radius + ALTITUDE) * (1 + ECCENTRICITY)
    r = semi_latus_rectum / (1 + ECCENTRICITY * nu.cos())
    u = nu - math.pi / 2  # argument of latitude, for an argument of periapsis of 270 degrees
    return r[:, None] * torch.stack((u.cos(), u.sin() * math.cos(i), u.sin() * math.sin(i)), dim=-1)


def terms(field: GravityField) -> dict[str, GravityField]:
    """Return the parts of a field: the central one, every zonal harmonic, and all tesserals together."""
    found = {"two-body": _part(field, slice(0, 1), slice(0, 1))}
    for n in range(2, field.degree + 1):
        found[f"J{n}"] = _part(field, slice(n, n + 1), slice(0, 1))
    return found | {"tesserals": _part(field, slice(2, None), slice(1, None))}


def _part(field: GravityField, degrees: slice, orders: slice) -> GravityField:
    """Return a field restricted to some coefficients."""
    parts = {}
    for name in ("cosines", "sines"):
        whole = getattr(field, name)
        part = whole * 0.0
        part[degrees, orders] = whole[degrees, orders]
        parts[name] = part
    return dataclasses.replace(field, **parts)
