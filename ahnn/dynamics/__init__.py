"""Learnable dynamics as plain modules: networks, input maps, energies, Hamiltonians and their flows.

The modules do not depend on a trainer: they can be compiled, exported and used in filters without one.
"""

from __future__ import annotations

from typing import Any

from ahnn.arguments import check_arguments
from ahnn.dynamics.base import Dynamics, HasEnergy, HasField, has_field
from ahnn.dynamics.fields import HamiltonianDynamics, NeuralDynamics
from ahnn.dynamics.generalised_hnn import GeneralisedHNN
from ahnn.dynamics.henon_net import HenonNet
from ahnn.dynamics.lagrangian import LagrangianDynamics
from ahnn.dynamics.next_state import NextState
from ahnn.dynamics.stacked_dynamics import StackedDynamics
from ahnn.dynamics.step_map import StepMap
from ahnn.dynamics.sympnet import SympNet
from ahnn.errors import UserError
from ahnn.extensions import Table
from ahnn.statistics import Statistics

KINDS: Table[type[Dynamics]] = Table(
    "ahnn.dynamics",
    {
        "hamiltonian": HamiltonianDynamics,
        "node": NeuralDynamics,
        "map": NextState,
        "lagrangian": LagrangianDynamics,
        "sympnet": SympNet,
        "henon_net": HenonNet,
        "generalised_hnn": GeneralisedHNN,
    },
)
"""Classes of dynamics, by the name under which they are stored."""


def make_dynamics(kind: str, **options: Any) -> Dynamics:
    """Build dynamics with newly initialised weights from plain values.

    Args:
        kind: a key of `KINDS`.
        options: arguments of its class.

    Raises:
        UserError: unknown kind or invalid arguments.
    """
    if kind not in KINDS:
        message = (
            f"dynamics: expected one of {', '.join(KINDS)}; received {kind!r}. Installed packages add kinds "
            f"in the entry-point group {KINDS.group}"
        )
        raise UserError(message)
    check_arguments("dynamics", KINDS[kind], options)
    made = KINDS[kind](**options)
    made.spec = {"kind": kind, **options}
    return made


__all__ = [
    "KINDS",
    "Dynamics",
    "HamiltonianDynamics",
    "HasEnergy",
    "HasField",
    "NeuralDynamics",
    "NextState",
    "StackedDynamics",
    "Statistics",
    "StepMap",
    "has_field",
    "make_dynamics",
]
