"""Learnable dynamics in one call, as torch modules for your own training loop.

    model = ahnn.Hamiltonian(dof=2, hidden=64, data=trajectories)
    optimizer = torch.optim.AdamW(model.parameters())
    loss = (model(x, dt) - x_next).square().mean()

Weights are newly drawn, in torch's default dtype; `double`, `to`, `state_dict` and `torch.compile` work as
usual.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from inspect import signature
from typing import Any, Literal, cast

import torch

from ahnn.arguments import Count, Positive, checked, nearest
from ahnn.dynamics import Dynamics, HamiltonianDynamics, NeuralDynamics, make_dynamics
from ahnn.dynamics.activations import ActivationName
from ahnn.dynamics.hamiltonians import Structure
from ahnn.dynamics.inputs import InputName
from ahnn.dynamics.lagrangian import LagrangianDynamics
from ahnn.dynamics.scaling import Kind
from ahnn.dynamics.step_map import StepMap
from ahnn.errors import UserError
from ahnn.statistics import Statistics
from ahnn.types import Trajectories

MapKind = Literal["sympnet", "henon_net", "generalised_hnn", "map"]
OF_KIND: dict[MapKind, dict[str, Any]] = {
    "sympnet": {"scaling": "block", "layers": 4, "form": "G"},
    "henon_net": {"scaling": "block", "layers": 4},
    "generalised_hnn": {"scaling": "block", "layers": 2},
    "map": {"scaling": "minmax", "residual": True},
}
"""Default options of each kind of map."""


@checked
def Hamiltonian(
    dof: Count,
    hidden: Count = 64,
    *,
    depth: Count = 2,
    activation: ActivationName | Literal["fourier"] = "tanh",
    structure: Structure = "generic",
    inertia: Positive | list[Positive] = 1.0,
    inputs: InputName = "cartesian",
    scaling: Kind = "block",
    integrator: str = "rk4",
    data: Trajectories | None = None,
    **options: Any,
) -> HamiltonianDynamics:
    """Build Hamilton's equations from a learned H(q, p), with a one-step integrator.

    `model(x, dt)` propagates states x = [q, p], (B, 2n), over dt, a number or (B,), of either sign;
    `model.rollout(start, steps, dt)` repeats it; `model.energy(x)` is H; `model.field(x)` is dx/dt.

    Args:
        dof: degrees of freedom n.
        hidden: units of each hidden layer.
        depth: number of hidden layers.
        activation: gelu, tanh, silu, sine, or fourier for a Gaussian process.
        structure: generic H(q, p), separable T(p) + V(q), mechanical p^2 / 2m + V(q), central_body,
            mass_matrix or pairs.
        inertia: m of `mechanical`, common or per coordinate.
        inputs: cartesian, isotropic, radial or angles.
        scaling: block, minmax or none.
        integrator: name of a method in `ahnn.integrators`; leapfrog and compositions need a separable H.
        data: trajectories that set scales and units; without them the network receives unscaled states.
        options: further options of `ahnn.dynamics.HamiltonianDynamics`: mu, falloff, dimensions, angular,
            forces, controls.

    Raises:
        UserError: an unknown option, a value out of range, options that contradict one another, or
            trajectories with a different number of components.
    """
    own = {"inertia": inertia, "hamiltonian": structure, "inputs": inputs, "scaling": scaling}
    own |= {"network": _network(hidden, depth, activation), "integrator": {"name": integrator}}
    _require(Hamiltonian, options, ("mu", "falloff", "dimensions", "angular", "forces", "controls"))
    made = make_dynamics("hamiltonian", dof=dof, **own, **{"mu": None, **options})
    return cast(HamiltonianDynamics, _scaled(made, dof, data))


@checked
def Lagrangian(
    dof: Count,
    hidden: Count = 64,
    *,
    depth: Count = 2,
    activation: ActivationName = "tanh",
    inertia: Positive | list[Positive] = 1.0,
    scaling: Kind = "minmax",
    integrator: str = "rk4",
    data: Trajectories | None = None,
) -> LagrangianDynamics:
    """Build Euler-Lagrange equations from a learned L(q, v), on states [q, p] with p = m dq/dt.

    Args:
        dof: degrees of freedom n.
        hidden: units of each hidden layer.
        depth: number of hidden layers.
        activation: gelu, tanh, silu or sine.
        inertia: m, common or per coordinate.
        scaling: minmax, block or none.
        integrator: name of a method in `ahnn.integrators`.
        data: trajectories that set scales and units.

    Raises:
        UserError: as for `Hamiltonian`.
    """
    options = {"inertia": inertia, "scaling": scaling, "network": _network(hidden, depth, activation)}
    made = make_dynamics("lagrangian", dof=dof, **options, integrator={"name": integrator})
    return cast(LagrangianDynamics, _scaled(made, dof, data))


@checked
def NeuralODE(
    dof: Count,
    hidden: Count = 64,
    *,
    depth: Count = 2,
    activation: ActivationName = "tanh",
    scaling: Kind = "minmax",
    integrator: str = "rk4",
    data: Trajectories | None = None,
) -> NeuralDynamics:
    """Build dx/dt = network(x) with a one-step integrator, without mechanical structure.

    Args:
        dof: degrees of freedom n.
        hidden: units of each hidden layer.
        depth: number of hidden layers.
        activation: gelu, tanh, silu or sine.
        scaling: minmax, block or none.
        integrator: name of a method in `ahnn.integrators`.
        data: trajectories that set scales and units.

    Raises:
        UserError: as for `Hamiltonian`.
    """
    options = {"scaling": scaling, "network": _network(hidden, depth, activation)}
    made = make_dynamics("node", dof=dof, **options, integrator={"name": integrator})
    return cast(NeuralDynamics, _scaled(made, dof, data))


@checked
def FlowMap(
    dof: Count,
    hidden: Count = 64,
    *,
    dt: Positive | None = None,
    kind: MapKind = "sympnet",
    depth: Count = 2,
    activation: ActivationName = "tanh",
    data: Trajectories | None = None,
    **options: Any,
) -> StepMap:
    """Build a map from one sample to the next, without a field and with a fixed step length.

    Args:
        dof: degrees of freedom n.
        hidden: units of each hidden layer.
        dt: step of the map; by default the sampling interval of the data.
        kind: sympnet, henon_net or generalised_hnn (symplectic for any weights), or map (a plain network).
        depth: number of hidden layers; modules of a sympnet have one.
        activation: gelu, tanh, silu or sine.
        data: trajectories that set scales and units.
        options: scaling and layers; form and shears for a sympnet; scaling and residual for map.

    Raises:
        UserError: as for `Hamiltonian`, or neither a step nor data.
    """
    if dt is None and data is None:
        message = "FlowMap: expected the step of the map as dt, or data to take it from; received neither"
        raise UserError(message)
    _require(FlowMap, options, (*OF_KIND[kind], *("shears",) * (kind == "sympnet")))
    network = _network(hidden, depth, activation)
    new = make_dynamics(kind, dof=dof, network=network, **{**OF_KIND[kind], **options})
    made = cast(StepMap, _scaled(new, dof, data))
    if dt is not None:
        made.dt.fill_(dt)
    return made


def _require(call: Callable[..., Any], options: dict[str, Any], further: Sequence[str]) -> None:
    """Raise UserError for an option that is not among the further options of a call."""
    known = [name for name in signature(call).parameters if name != "options"] + [*further]
    if unknown := [name for name in options if name not in further]:
        message = f"{call.__name__}: unknown option {unknown[0]!r}{nearest(unknown[0], known)}"
        raise UserError(message)


def _network(hidden: int, depth: int, activation: str) -> dict[str, Any]:
    return {"width": hidden, "depth": depth, "activation": activation}


def _scaled(made: Dynamics, dof: int, data: Trajectories | None) -> Dynamics:
    """Set scales and units of new dynamics from trajectories, if there are any."""
    if data is not None:
        from ahnn.data.in_memory import check_states

        with torch.no_grad():
            made.fit(Statistics.of(check_states(data, dof)))
    return made
