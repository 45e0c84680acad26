"""Keplerian elements: the Cartesian state at periapsis and the period of an orbit."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor


class Elements(NamedTuple):
    """Orbital elements with the periapsis radius; lengths in km, angles in degrees, all of shape (B,)."""

    periapsis: Tensor
    eccentricity: Tensor
    inclination: Tensor
    raan: Tensor
    argument_of_periapsis: Tensor


def state_at_periapsis(elements: Elements, mu: float, mass: float) -> Tensor:
    """Return (q, p) at periapsis, shape (B, 6), in km and kg km/s.

    The perifocal axes P (towards periapsis) and Q (along the velocity there) follow from the rotation
    R3(-RAAN) R1(-i) R3(-argument of periapsis) (Vallado, Fundamentals of Astrodynamics, section 2.6).
    """
    i, raan, w = (torch.deg2rad(a) for a in elements[2:])
    cos_w, sin_w, cos_i, sin_i, cos_o, sin_o = w.cos(), w.sin(), i.cos(), i.sin(), raan.cos(), raan.sin()
    towards = torch.stack(
        (cos_o * cos_w - sin_o * sin_w * cos_i, sin_o * cos_w + cos_o * sin_w * cos_i, sin_w * sin_i), dim=-1
    )
    along = torch.stack(
        (-cos_o * sin_w - sin_o * cos_w * cos_i, -sin_o * sin_w + cos_o * cos_w * cos_i, cos_w * sin_i),
        dim=-1,
    )
    speed = (mu * (1 + elements.eccentricity) / elements.periapsis).sqrt()
    return torch.cat((elements.periapsis[:, None] * towards, mass * speed[:, None] * along), dim=-1)


def period(x: Tensor, mu: float, mass: float) -> Tensor:
    """Return the two-body period in s, shape (B,), of the orbits through x, shape (B, 6) (vis-viva)."""
    q, p = x.chunk(2, dim=-1)
    v = p / mass
    semi_major_axis = 1 / (2 / q.norm(dim=-1) - (v * v).sum(-1) / mu)
    return 2 * math.pi * (semi_major_axis**3 / mu).sqrt()
