"""Non-Hamiltonian and known forces: friction, actuation, forcing, attraction and networks.

Each force is a class, registered under the name by which it is stored. Forces are summed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ahnn.arguments import check_arguments
from ahnn.dynamics.forces.actuation import Actuation
from ahnn.dynamics.forces.attraction import CentralAttraction, Oblateness
from ahnn.dynamics.forces.base import Force, Instant
from ahnn.dynamics.forces.equator import EllipticEquator
from ahnn.dynamics.forces.forcing import Forcing
from ahnn.dynamics.forces.friction import Friction
from ahnn.dynamics.forces.network import NetworkForce
from ahnn.dynamics.forces.orbital import OrbitalForce
from ahnn.dynamics.forces.spring import Spring
from ahnn.dynamics.forces.third_bodies import ThirdBodies
from ahnn.errors import UserError
from ahnn.extensions import Table

FORCES: Table[Callable[..., Force]] = Table(
    "ahnn.forces",
    {
        "friction": Friction,
        "actuation": Actuation,
        "forcing": Forcing,
        "network": NetworkForce,
        "spring": Spring,
        "central_attraction": CentralAttraction,
        "oblateness": Oblateness,
        "third_bodies": ThirdBodies,
        "elliptic_equator": EllipticEquator,
        "orbital": OrbitalForce,
    },
)
"""Registered forces by name; called with `dof`, `controls` and options."""


def make_force(name: str, dof: int, controls: int, options: Mapping[str, Any]) -> Force:
    """Build a force with newly initialised parameters.

    Args:
        name: name of the force in the configuration, for messages.
        dof: degrees of freedom n.
        controls: number m of controls.
        options: `kind`, a key of `FORCES`, and the arguments of its class.

    Raises:
        UserError: unknown kind or invalid arguments.
    """
    own = dict(options)
    kind = own.pop("kind", name)
    if kind not in FORCES:
        message = (
            f"forces.{name}: expected kind, one of {', '.join(FORCES)}; received {kind!r}. Installed "
            f"packages add kinds in the entry-point group {FORCES.group}"
        )
        raise UserError(message)
    check_arguments(f"forces.{name}", FORCES[kind], own, ("dof", "controls"))
    force = FORCES[kind](dof=dof, controls=controls, **own)
    if force.controlled and not controls:
        message = f"forces.{name}: expected data with controls; received a space without any"
        raise UserError(message)
    return force


__all__ = [
    "FORCES",
    "Actuation",
    "CentralAttraction",
    "EllipticEquator",
    "Force",
    "Forcing",
    "Friction",
    "Instant",
    "NetworkForce",
    "Oblateness",
    "OrbitalForce",
    "Spring",
    "ThirdBodies",
    "make_force",
]
