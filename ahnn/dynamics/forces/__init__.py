"""Forces beside a Hamiltonian: friction, actuation, forcing, known attractions, and networks.

A force is one class in one file, under a name by which it is stored. Forces add up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ahnn.arguments import check_arguments
from ahnn.dynamics.forces.actuation import Actuation
from ahnn.dynamics.forces.attraction import CentralAttraction, Oblateness
from ahnn.dynamics.forces.axial import AxialNetwork
from ahnn.dynamics.forces.base import Force, Instant
from ahnn.dynamics.forces.forcing import Forcing
from ahnn.dynamics.forces.friction import Friction
from ahnn.dynamics.forces.network import NetworkForce
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
        "axial": AxialNetwork,
    },
)
"""Names under which forces are stored, and what is built for them: called with `dof`, `controls`, options."""


def make_force(name: str, dof: int, controls: int, options: Mapping[str, Any]) -> Force:
    """Return a force with fresh parameters.

    Args:
        name: under which it was asked for, for messages.
        dof: degrees of freedom n.
        controls: m, numbers that the user sets.
        options: `kind`, a key of `FORCES`, and the arguments of its class.

    Raises:
        UserError: unknown kind, or arguments that make no force.
    """
    own = dict(options)
    kind = own.pop("kind", name)
    if kind not in FORCES:
        message = (
            f"forces.{name}: expected kind, one of {', '.join(FORCES)}; received {kind!r}. Others are those "
            f"of installed packages that declare them in the entry-point group {FORCES.group}"
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
    "AxialNetwork",
    "CentralAttraction",
    "Force",
    "Forcing",
    "Friction",
    "Instant",
    "NetworkForce",
    "Oblateness",
    "Spring",
    "ThirdBodies",
    "make_force",
]
