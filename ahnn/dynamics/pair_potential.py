"""Learned pair potential: V = sum over i < j of m_i m_j phi(|q_i - q_j|).

V is invariant under exchange of bodies, translation and rotation. `for_bodies` transfers it to a different
number of bodies.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, cast

import torch
from torch import Tensor, nn

from ahnn.dynamics.energies import Quadratic, energy_units
from ahnn.dynamics.hessians import is_closed
from ahnn.dynamics.networks import make_network
from ahnn.errors import UserError
from ahnn.numbers import Numbers, as_float64
from ahnn.statistics import Statistics


class PairPotential(nn.Module):
    """Sum of m_i m_j phi(r_ij), phi(r) = unit (R / r)^k N(log r), with the shortest training distance R.

    Args:
        dof: degrees of freedom n, `dimensions` for each body: (x_1, y_1, x_2, y_2, ...).
        mass: mass of the coordinates, common or (n,).
        dimensions: dimension of physical space.
        falloff: decay exponent k.
        network: width, depth, activation of N.

    Raises:
        UserError: fewer than two bodies, a number of coordinates that is not a multiple of the dimension, or
            different masses of the coordinates of a body.
    """

    middle: Tensor
    spread: Tensor
    nearest: Tensor
    unit: Tensor

    def __init__(
        self,
        dof: int,
        mass: float | Sequence[float],
        *,
        dimensions: int,
        falloff: float,
        network: dict[str, Any],
    ) -> None:
        super().__init__()
        self.dimensions, self.falloff = dimensions, falloff
        self.masses = body_masses(dof, mass, dimensions)
        self.network = make_network(1, 1, network)
        for name in ("middle", "spread", "nearest", "unit"):
            self.register_buffer(name, torch.ones(()))

    def fit(self, statistics: Statistics) -> None:
        """Set the range of distances, and the energy unit of a pair."""
        distances = self.distances(statistics.positions)[1]
        logs = torch.stack((distances.min(), distances.max())).log()
        self.middle.copy_(logs.mean())
        self.spread.copy_((logs[1] - logs[0]).clamp(min=1e-3) / 2)
        self.nearest.copy_(logs[0].exp())
        self.unit.copy_(energy_units(statistics)[0] / float(self.products(statistics.positions).mean()))

    def pairs(self, like: Tensor) -> tuple[Tensor, Tensor]:
        """Return the indices i < j of all pairs of bodies, (P,) each."""
        first, second = torch.triu_indices(len(self.masses), len(self.masses), 1, device=like.device)
        return first, second

    def products(self, like: Tensor) -> Tensor:
        """Return m_i m_j for all pairs, (P,)."""
        first, second = self.pairs(like)
        masses = torch.tensor(self.masses).to(like)
        return masses[first] * masses[second]

    def distances(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Return q_i - q_j, (..., P, d), and distances, (..., P), of all pairs at q, (..., n)."""
        bodies = q.unflatten(-1, (len(self.masses), self.dimensions))
        first, second = self.pairs(q)
        between = bodies[..., first, :] - bodies[..., second, :]
        return between, between.norm(dim=-1)

    def forward(self, q: Tensor) -> Tensor:
        """Return V, shape (...), at q, shape (..., n)."""
        r = self.distances(q)[1]
        value = self.network(self.scaled(r)).squeeze(-1) * (self.nearest / r) ** self.falloff
        return self.unit * (self.products(q) * value).sum(-1)

    def scaled(self, r: Tensor) -> Tensor:
        """Return the network inputs, (..., 1), at the distances r."""
        return ((r.log() - self.middle) / self.spread).unsqueeze(-1)

    def gradient(self, q: Tensor) -> Tensor:
        """Return dV/dq, shape (..., n), at q, shape (..., n)."""
        r = self.distances(q)[1]
        z = self.scaled(r)
        value, rise = (part.squeeze(-1) for part in (self.network(z), self.network.gradient(z)))
        slope = rise / self.spread - self.falloff * value
        return (self.pulls(q) @ slope.unsqueeze(-1)).squeeze(-1)

    def pulls(self, q: Tensor) -> Tensor:
        """Return the factors in dV/dq of dN/dlog r - k N for each pair, (..., n, P), at q, (..., n)."""
        between, r = self.distances(q)
        first, second = self.pairs(q)
        count = len(self.masses)
        signs = nn.functional.one_hot(first, count) - nn.functional.one_hot(second, count)
        size = self.unit * self.products(q) * (self.nearest / r) ** self.falloff / r.square()
        return torch.einsum("pb,...p,...pd->...bdp", signs.to(q), size, between).flatten(-3, -2)

    @property
    def has_rows(self) -> bool:
        """Whether the network's parameter derivatives are available in closed form."""
        return is_closed(self.network)

    def write_rows(self, theta: Tensor, q: Tensor, factors: Tensor, out: Tensor) -> None:
        """Write factors (B, n) times d(dV/dq)/dtheta to `out`, (B, n, P), for parameters theta, (P,)."""
        r = self.distances(q)[1]
        z = self.scaled(r).flatten(0, 1).to(theta)
        on_rise, on_value = theta.new_ones(len(z), 1, 1) / self.spread.to(theta), theta.new_ones(len(z), 1)
        rows = theta.new_empty(len(z), 1, len(theta))
        self.network.write_rows(theta, z, on_rise, -self.falloff * on_value, rows)
        by = (factors.unsqueeze(-1) * self.pulls(q)).to(theta)
        out.copy_(by @ rows.view(*r.shape, -1))

    def seen(self, q: Tensor) -> Tensor:
        """Return the logarithms of all distances, scaled and in increasing order, shape (..., P)."""
        return self.scaled(self.distances(q)[1]).squeeze(-1).sort(-1).values


def body_masses(dof: int, mass: float | Sequence[float], dimensions: int) -> list[float]:
    """Return the mass of each body; raises UserError for coordinates that do not form bodies."""
    if dof % dimensions or dof < 2 * dimensions:
        message = (
            f"hamiltonian pairs: expected {dimensions} coordinates for each of two or more bodies; received "
            f"{dof}. model.dimensions sets the number per body"
        )
        raise UserError(message)
    each = [float(mass)] * dof if isinstance(mass, int | float) else [*mass]
    bodies = [each[k : k + dimensions] for k in range(0, dof, dimensions)]
    if len(each) != dof or any(len({*own}) > 1 for own in bodies):
        message = f"hamiltonian pairs: expected one mass for all coordinates of a body; received {mass}"
        raise UserError(message)
    return [own[0] for own in bodies]


def for_bodies(dynamics: nn.Module, masses: Numbers) -> nn.Module:
    """Transfer learned pair dynamics to other bodies.

    The result propagates states of its own bodies, (B, 2 n) with n = bodies * dimensions, and can be saved
    with `ahnn.save`.

    Args:
        dynamics: `HamiltonianDynamics` with hamiltonian=pairs.
        masses: masses of two or more bodies.

    Raises:
        UserError: dynamics with a different structure, or invalid masses.
    """
    found: Any = copy.deepcopy(dynamics)
    field = getattr(found, "field", None)
    potential = getattr(field, "potential", None)
    if not isinstance(potential, PairPotential):
        message = f"for_bodies: expected dynamics with hamiltonian=pairs; received {type(dynamics).__name__}"
        raise UserError(message)
    given = as_float64(masses, "masses")
    if given.ndim != 1 or len(given) < 2 or not ((given > 0) & given.isfinite()).all():
        message = f"masses: expected two or more finite masses > 0; received {given.tolist()}"
        raise UserError(message)
    potential.masses = given.tolist()
    inertia = [mass for mass in potential.masses for _ in range(potential.dimensions)]
    cast(Any, field).kinetic = Quadratic(inertia).to(potential.unit)
    if hasattr(found, "spec"):
        found.spec = {**found.spec, "dof": len(inertia), "inertia": inertia}
    return found
