"""Attraction by bodies at known positions: Sun and Moon on a satellite, planets on each other."""

from __future__ import annotations

from typing import Any, ClassVar, final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ahnn.arguments import Finite, NonNegative, Positive, checked
from ahnn.dynamics.forces.base import Force, Instant
from ahnn.errors import UserError
from ahnn.optional_libraries import library

PARAMETERS = {"sun": "GMS", "mercury": "GM1", "venus": "GM2", "earthmoon": "GMB", "earth": "GMB"}
PARAMETERS |= {"moon": "GMB", "mars": "GM4", "jupiter": "GM5", "saturn": "GM6", "uranus": "GM7"}
PARAMETERS |= {"neptune": "GM8", "pluto": "GM9"}
"""DE421 constant with the gravitational parameter of each body, or of Earth and Moon together."""
MARGIN = 2
"""Nodes before and after the requested span."""


@final
@checked
class ThirdBodies(Force):
    """Attraction by bodies of DE421, minus their attraction of the centre (Montenbruck & Gill, 3.37).

    m sum_j mu_j ((r_j - q) / |r_j - q|^3 - r_j / r_j^3), in ICRF axes. A moving body closer than `own` to
    one of these bodies is identified with it: it does not attract itself, and the second term is the
    contribution of its own mass to the motion about the centre.

    Args:
        dof: 3.
        controls: not used.
        bodies: names in DE421, which also defines their masses; `earthmoon` is the barycentre of both.
        center: name of the body at the origin, for example `sun` or `earth`.
        epoch: Julian date, TDB, of time zero.
        span: first and last time at which the force is defined.
        spacing: time between tabulated positions, interpolated by cubics.
        day: units of time per day.
        length: kilometres per unit of the positions.
        own: distance below which a body exerts no direct attraction.
        mass: mass m of the moving body.

    Raises:
        UserError: not three coordinates, no bodies, an empty span, bodies or dates that DE421 does not
            contain, or DE421 is missing.
    """

    timed: ClassVar[bool] = True

    def __init__(
        self,
        dof: int,
        controls: int = 0,
        *,
        bodies: list[str],
        center: str,
        epoch: Finite,
        span: list[Finite],
        spacing: Positive,
        day: Positive,
        length: Positive,
        own: NonNegative = 0.0,
        mass: Positive = 1.0,
    ) -> None:
        super().__init__()
        if dof != 3 or len(span) != 2 or span[0] >= span[1] or not bodies:
            message = (
                "third_bodies: expected bodies, three coordinates and a span that ends after it begins; "
                f"received {bodies}, {dof} and {span}"
            )
            raise UserError(message)
        self.assumes = f"known {', '.join(bodies)}"
        self.begin, self.spacing, self.own = span[0] - MARGIN * spacing, spacing, own
        self.nodes = int((span[1] - span[0]) / spacing) + 2 * MARGIN + 2
        # Not buffers, so that the nodes remain float64 for weights of any dtype.
        times = np.asarray((self.begin + spacing * np.arange(self.nodes)) / day, dtype=np.float64)
        ephemeris = opened([center, *bodies], epoch, times)
        unit = (ephemeris.AU / length) ** 3 / day**2
        strengths = [mass * unit * parameter(ephemeris, name) for name in bodies]
        self.strengths = torch.tensor(strengths, dtype=torch.float64)
        origin = barycentric(ephemeris, center, epoch, times)
        found = [barycentric(ephemeris, name, epoch, times) - origin for name in bodies]
        # (K, J, 2, 3): positions, and velocities times the spacing.
        scale = np.array([1.0, spacing / day])[:, None] / length
        self.table = torch.from_numpy(np.stack(found, 1) * scale)

    def places(self, t: Tensor) -> Tensor:
        """Return the positions of the bodies, (..., J, 3), at times t, (..., 1); NaN outside the span."""
        return self._motion(t)[0]

    def _motion(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """Return positions and velocities, (..., J, 3) each, at times t, (..., 1); NaN outside the span."""
        since = (t[..., 0].double() - self.begin) / self.spacing
        node = since.floor().clamp(0, self.nodes - 2)
        s = (since - node)[..., None, None]
        k, table = node.long(), self.table.to(t.device)
        (a, da), (b, db) = (table[j].unbind(-2) for j in (k, k + 1))
        square, cube = 3 * (b - a) - 2 * da - db, 2 * (a - b) + da + db
        inside = (s >= 0) & (s <= 1)
        place, velocity = a + s * (da + s * (square + s * cube)), da + s * (2 * square + 3 * s * cube)
        return place.where(inside, torch.nan), velocity.where(inside, torch.nan) / self.spacing

    def forward(self, at: Instant) -> Tensor:
        """Return the force, shape (..., 3)."""
        body = self.places(at.t)
        line = body - at.q.unsqueeze(-2)
        far = line.norm(dim=-1, keepdim=True)
        direct = (line / far.clamp(min=self.own) ** 3).where(far > self.own, 0.0)
        pulls = direct - body / body.norm(dim=-1, keepdim=True) ** 3
        return (self.strengths.to(body.device).unsqueeze(-1) * pulls).sum(-2).to(at.q)

    def variation(self, at: Instant, by: Instant) -> Tensor:
        """Return the variation of the force with position and time, shape (B, R, 3)."""
        body, velocity = (part.unsqueeze(1) for part in self._motion(at.t))  # (B, 1, J, 3)
        shift = velocity * by.t.unsqueeze(-1) if by.t.shape[-1] else torch.zeros_like(body)
        line = body - at.q[:, None, None]
        far = line.norm(dim=-1, keepdim=True)
        direct = _varied_pull(line, shift - by.q.unsqueeze(-2)).where(far > self.own, 0.0)
        pulls = direct - _varied_pull(body, shift)
        return (self.strengths.to(body.device).unsqueeze(-1) * pulls).sum(-2).to(at.q)


def _varied_pull(line: Tensor, by: Tensor) -> Tensor:
    """Return the variation of line / |line|^3, (..., 3)."""
    square = line.square().sum(-1, keepdim=True)
    return (by - 3 * (line * by).sum(-1, keepdim=True) / square * line) / square**1.5


def opened(names: list[str], epoch: float, days: NDArray[np.float64]) -> Any:
    """Return the ephemeris DE421, after checks of the bodies and dates.

    Args:
        names: names of bodies, the centre first.
        epoch: Julian date.
        days: days after `epoch`, (K,).

    Raises:
        UserError: DE421 is missing or lacks a body or date, or the centre is among the other bodies.
    """
    data = library("de421", "de421", "ephemeris", "third_bodies")
    ephemeris = library("jplephem.ephem", "jplephem", "ephemeris", "third_bodies").Ephemeris(data)
    first, last = ephemeris.jalpha - epoch, ephemeris.jomega - epoch
    if not {*names} <= {*PARAMETERS} or names[0] in names[1:] or days[0] < first or days[-1] > last:
        message = (
            f"third_bodies: expected a center and other bodies among {', '.join(PARAMETERS)}, and days from "
            f"{first:.1f} to {last:.1f}; received {', '.join(names)}, {days[0]:.1f} to {days[-1]:.1f}"
        )
        raise UserError(message)
    return ephemeris


def parameter(ephemeris: Any, name: str) -> float:
    """Return the gravitational parameter of a body in DE421, au^3/d^2."""
    fraction = {"earth": 1 - ephemeris.earth_share, "moon": ephemeris.earth_share}.get(name, 1.0)
    return fraction * getattr(ephemeris, PARAMETERS[name])


def barycentric(ephemeris: Any, name: str, epoch: float, days: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions and velocities (K, 2, 3) about the barycentre of the solar system."""

    def read(body: str) -> NDArray[np.float64]:
        return np.stack(ephemeris.position_and_velocity(body, epoch, days)).transpose(2, 0, 1)

    if name not in ("earth", "moon"):
        return read(name)
    moon = read("moon")  # from the Earth's centre
    earth = read("earthmoon") - moon * ephemeris.earth_share
    return earth if name == "earth" else earth + moon
