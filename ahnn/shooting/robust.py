"""Robust losses of residuals in standard deviations, as residuals whose squares are summed.

A loss rho(e) becomes the pseudo-residual sign(e) sqrt(2 rho(e)): Gauss-Newton steps then need no weights of
their own, and an ordinary sum of squares says whether a step was good (Triggs et al. 2000, section 4.3).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import torch
from torch import Tensor

RobustName = Literal["none", "huber", "student"]
HUBER = 1.345
"""Residual from which Huber's loss is linear; efficiency 95 % on normal noise (Huber 1981)."""
FREEDOM = 4.0
"""Degrees of freedom of Student's distribution (Lange, Little & Taylor 1989)."""


class Robust(NamedTuple):
    """A loss of residuals e.

    Attributes:
        pseudo: e -> sign(e) sqrt(2 rho(e)).
        slope: its derivative.
    """

    pseudo: Callable[[Tensor], Tensor]
    slope: Callable[[Tensor], Tensor]


def _huber(e: Tensor) -> Tensor:
    far = (2 * HUBER * e.abs() - HUBER**2).clamp(min=HUBER**2).sqrt() * e.sign()
    return torch.where(e.abs() <= HUBER, e, far)


def _huber_slope(e: Tensor) -> Tensor:
    return torch.where(e.abs() <= HUBER, torch.ones_like(e), HUBER / _huber(e).abs().clamp(min=HUBER))


def _student(e: Tensor) -> Tensor:
    return e.sign() * ((FREEDOM + 1) * torch.log1p(e * e / FREEDOM)).sqrt()


def _student_slope(e: Tensor) -> Tensor:
    near = e.abs() < 1e-6
    pseudo = torch.where(near, torch.ones_like(e), _student(e))
    away = (FREEDOM + 1) / FREEDOM * e / (1 + e * e / FREEDOM) / pseudo
    return torch.where(near, torch.full_like(e, ((FREEDOM + 1) / FREEDOM) ** 0.5), away)


ROBUST: dict[str, Robust] = {
    "none": Robust(lambda e: e, torch.ones_like),
    "huber": Robust(_huber, _huber_slope),
    "student": Robust(_student, _student_slope),
}
