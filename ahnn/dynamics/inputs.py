"""Input maps from physical coordinates to network inputs, with pullbacks of gradients."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import torch
from torch import Tensor, nn
from torch.linalg import vector_norm

from ahnn.arguments import checked
from ahnn.dynamics.scaling import Affine, Kind
from ahnn.errors import UserError
from ahnn.statistics import Statistics

InputName = Literal["cartesian", "isotropic", "radial", "angles"]

Pullback = Callable[[Tensor], Tensor]
"""Pullback: gradient with respect to network inputs -> gradient with respect to coordinates."""


def slopes(z: Tensor, pullback: Pullback) -> Tensor:
    """Return dz/dq, shape (B, F, n), from the pullback at z, shape (B, F)."""
    return torch.stack([pullback(unit.expand_as(z)) for unit in torch.eye(z.shape[-1]).to(z)], dim=-2)


class LogDistance(nn.Module):
    """The logarithm of the distance from the origin, scaled to [-1, 1]."""

    name: InputName
    middle: Tensor
    spread: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("middle", torch.zeros(()))
        self.register_buffer("spread", torch.ones(()))

    def fit(self, statistics: Statistics) -> None:
        """Set the range of log r from the training split.

        Raises:
            UserError: the data include the centre, or all have the same distance from it.
        """
        low, high = (float(r) for r in statistics.radius)
        if not 0 < low < high:
            message = (
                f"inputs {self.name}: expected distances 0 < low < high from the centre; received {low} to "
                f"{high}. Use inputs=cartesian for this system."
            )
            raise UserError(message)
        logs = statistics.radius.log()
        self.middle.copy_(logs.mean())
        self.spread.copy_((logs[1] - logs[0]) / 2)

    def scaled(self, r: Tensor) -> Tensor:
        """Return the scaled log distance s at distances r, shape (...)."""
        return (r.log() - self.middle) / self.spread


class Isotropic(LogDistance):
    """Direction and distance, z = (q / r, s) with s the logarithm of r scaled to [-1, 1].

    The map suits any force from a centre: equal ratios of distances become equal differences of s. It assumes
    the position of the centre but nothing about the force. Despite its name, it keeps the direction and does
    not impose isotropy.

    Args:
        dof: degrees of freedom n; the map has n + 1 outputs.
    """

    name = "isotropic"

    def __init__(self, dof: int) -> None:
        super().__init__()
        self.size = dof + 1

    def forward(self, q: Tensor) -> Tensor:
        """Return (q / r, s), shape (..., n + 1), at the positions q, shape (..., n)."""
        return self.linearised(q)[0]

    def linearised(self, q: Tensor) -> tuple[Tensor, Pullback]:
        """Return z at q and the pullback of gradients at that point, which share intermediate results."""
        r = vector_norm(q, dim=-1, keepdim=True)
        inverse = r.reciprocal()
        direction = q * inverse

        def pullback(gradient: Tensor) -> Tensor:
            g, along = gradient.split_with_sizes((self.size - 1, 1), -1)
            radial = along / self.spread - (direction * g).sum(-1, keepdim=True)
            return (g + radial * direction) * inverse

        return torch.cat((direction, self.scaled(r)), dim=-1), pullback

    def curvature(self, q: Tensor, gradient: Tensor) -> Tensor:
        """Return the second derivative of z contracted with the gradient with respect to z, (..., n, n)."""
        r = vector_norm(q, dim=-1, keepdim=True)
        direction = q / r
        g, along = gradient.split_with_sizes((self.size - 1, 1), -1)
        towards, along = (direction * g).sum(-1, keepdim=True), along / self.spread
        tilt = direction.unsqueeze(-1) * (g - towards * direction).unsqueeze(-2)
        square = direction.unsqueeze(-1) * direction.unsqueeze(-2)
        one = torch.eye(q.shape[-1]).to(q)
        across, outwards = (along - towards).unsqueeze(-1) * (one - square), along.unsqueeze(-1) * square
        return (across - outwards - tilt - tilt.mT) / r.square().unsqueeze(-1)


class Radial(LogDistance):
    """Distance only, z = s, for a central force that is the same in all directions.

    Unlike `Isotropic`, this map assumes isotropy: a network learns one radial profile from orbits at
    different distances.
    """

    name, size = "radial", 1

    def forward(self, q: Tensor) -> Tensor:
        """Return s, shape (..., 1), at the positions q, shape (..., n)."""
        return self.linearised(q)[0]

    def linearised(self, q: Tensor) -> tuple[Tensor, Pullback]:
        """Return s and the pullback of gradients at that point."""
        square = q.square().sum(-1, keepdim=True)
        return self.scaled(square.sqrt()), lambda gradient: gradient / (self.spread * square) * q

    def curvature(self, q: Tensor, gradient: Tensor) -> Tensor:
        """Return the second derivative of s times the gradient with respect to s, shape (..., n, n)."""
        square = q.square().sum(-1, keepdim=True)
        by = (gradient / (self.spread * square)).unsqueeze(-1)
        q = q / square.sqrt()
        return by * (torch.eye(q.shape[-1]).to(q) - 2 * q.unsqueeze(-1) * q.unsqueeze(-2))


class Cartesian(nn.Module):
    """Scaled components of one block of the state, positions or momenta.

    Args:
        dof: degrees of freedom n.
        scaling: minmax, block or none.
        block: 0 for the positions, 1 for the momenta.
    """

    def __init__(self, dof: int, scaling: Kind, block: Literal[0, 1]) -> None:
        super().__init__()
        self.size = dof
        self.part = slice(block * dof, (block + 1) * dof)
        self.affine = Affine(scaling, dof)

    def fit(self, statistics: Statistics) -> None:
        """Set the scaling from the training split; raises UserError for a constant component."""
        self.affine.fit(statistics.minimum[self.part], statistics.maximum[self.part])

    def forward(self, q: Tensor) -> Tensor:
        """Return scaled components, shape (..., n)."""
        return self.affine(q)

    def linearised(self, q: Tensor) -> tuple[Tensor, Pullback]:
        """Return z at q and the pullback of gradients, which is constant."""
        return self.affine(q), self.affine.pullback

    def curvature(self, q: Tensor, gradient: Tensor) -> Tensor:
        """Return zeros, shape (..., n, n): the map is affine."""
        return q.new_zeros(*q.shape, q.shape[-1])


class Angles(nn.Module):
    """Cosines and sines of angles, and the other coordinates scaled: learned functions have period 2 pi.

    Args:
        angular: which of the n coordinates are angles, in rad.
        scaling: scaling of the other coordinates: minmax, block or none.
    """

    def __init__(self, angular: Sequence[bool], scaling: Kind) -> None:
        super().__init__()
        self.turning = [k for k, is_angle in enumerate(angular) if is_angle]
        self.straight = [k for k, is_angle in enumerate(angular) if not is_angle]
        self.affine = Affine(scaling, len(self.straight))
        self.size = len(angular) + len(self.turning)

    def fit(self, statistics: Statistics) -> None:
        """Set the scaling of coordinates that are not angles; raises UserError for a constant component."""
        if self.straight:
            dof = len(self.straight) + len(self.turning)
            self.affine.fit(statistics.minimum[:dof][self.straight], statistics.maximum[:dof][self.straight])

    def forward(self, q: Tensor) -> Tensor:
        """Return cosines, sines and scaled components, shape (..., F), at the positions q, shape (..., n)."""
        angle = q[..., self.turning]
        return torch.cat((angle.cos(), angle.sin(), self.affine(q[..., self.straight])), dim=-1)

    def linearised(self, q: Tensor) -> tuple[Tensor, Pullback]:
        """Return z at q and the pullback of gradients at that point."""
        z, count = self(q), len(self.turning)
        order = [*self.turning, *self.straight]
        back = [order.index(k) for k in range(len(order))]

        def pullback(gradient: Tensor) -> Tensor:
            of_cosine, of_sine, others = gradient.split((count, count, len(self.straight)), dim=-1)
            turned = z[..., :count] * of_sine - z[..., count : 2 * count] * of_cosine
            return torch.cat((turned, self.affine.pullback(others)), dim=-1)[..., back]

        return z, pullback

    def curvature(self, q: Tensor, gradient: Tensor) -> Tensor:
        """Return the second derivative of z contracted with the gradient with respect to z, (..., n, n)."""
        angle, count = q[..., self.turning], len(self.turning)
        bent = torch.zeros_like(q)
        bent[..., self.turning] = -(
            angle.cos() * gradient[..., :count] + angle.sin() * gradient[..., count : 2 * count]
        )
        return torch.diag_embed(bent)


InputMap = Cartesian | Isotropic | Radial | Angles


@checked
def position_inputs(name: InputName, dof: int, scaling: Kind, angular: list[bool] | None = None) -> InputMap:
    """Build the input map of the positions.

    Args:
        name: name of the map.
        dof: degrees of freedom n.
        scaling: minmax, block or none.
        angular: which coordinates are angles, for `angles`.

    Raises:
        UserError: unknown name, `angles` without angular coordinates, or a distance map in one dimension.
    """
    if name == "cartesian":
        return Cartesian(dof, scaling, 0)
    if name == "angles":
        if not angular or len(angular) != dof or not any(angular):
            message = (
                f"inputs angles: expected coordinates that are angles, in rad; received {angular}. All "
                "coordinates are angles if their unit is rad, otherwise only those in `Space.angles`. "
                "Without a Space, set angular, such as [True, False]"
            )
            raise UserError(message)
        return Angles(angular, scaling)
    if dof < 2:
        message = f"inputs {name}: expected a system of at least 2 degrees of freedom; received 1"
        raise UserError(message)
    return Isotropic(dof) if name == "isotropic" else Radial()


class ScaledStates(nn.Module):
    """Network inputs from states: mapped positions and scaled momenta.

    Args:
        dof: degrees of freedom n.
        inputs: input map of the positions: cartesian, isotropic, radial or angles.
        scaling: minmax, block or none.
        angular: which coordinates are angles.
    """

    def __init__(self, dof: int, inputs: InputName, scaling: Kind, angular: list[bool] | None) -> None:
        super().__init__()
        self.positions = position_inputs(inputs, dof, scaling, angular)
        self.momenta = Cartesian(dof, scaling, 1)

    def fit(self, statistics: Statistics) -> None:
        """Fit both maps to the training split."""
        self.positions.fit(statistics)
        self.momenta.fit(statistics)
