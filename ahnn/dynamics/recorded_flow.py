"""Recorded flows: traced sequences of operations, equal up to rounding, without Python overhead.

For a small network and the 13 sigma points of one state, Python takes more time than arithmetic; a replayed
sequence takes a quarter of the time. Only flows with data-independent operations are recorded: explicit
integrators and maps, but not iterations to convergence.
"""

from __future__ import annotations

import copy
import threading
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import torch
from torch import Tensor
from torch.nn.utils import vector_to_parameters

from ahnn.compiled_libraries import followed
from ahnn.dynamics.base import Dynamics
from ahnn.dynamics.fields import HamiltonianDynamics, NeuralDynamics
from ahnn.dynamics.learned_flow import learned_flow
from ahnn.dynamics.next_state import NextState
from ahnn.dynamics.transition import transition
from ahnn.integrators.explicit import ExplicitRungeKutta
from ahnn.integrators.symplectic import SymmetricComposition
from ahnn.rollouts import clock_of
from ahnn.types import Flow, TimeStep

SETTLED = 3
"""Number of calls until a recording reaches full speed."""
WORTH = 150
"""Number of calls that cost as much as a recording."""
_RECORDING = threading.Lock()
"""Lock held during recording, since threads share one recording."""


def recorded(flow: Flow) -> Flow:
    """Return the flow in C or as a recording, equal up to rounding, for one step length, without gradients.

    Dynamics with data-dependent operations, and unknown functions, are returned unchanged.
    """
    return learned_flow(flow) or (_Recorded(flow) if is_fixed(flow) else flow)


def is_fixed(flow: Flow) -> bool:
    """Return whether a flow consists of dynamics with data-independent operations."""
    if clock_of(flow) > 1:  # controls
        return False
    if isinstance(flow, HamiltonianDynamics | NeuralDynamics):
        return isinstance(flow.integrator, ExplicitRungeKutta | SymmetricComposition)
    return isinstance(flow, NextState)


class _Recorded:
    """Recordings of a flow, one per shape of the states."""

    def __init__(self, flow: Flow) -> None:
        self.flow, self.clock = flow, clock_of(flow)
        self._known: dict[torch.Size, Callable[[Tensor, Tensor], Tensor]] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_known": {}}  # recordings cannot be copied, so they are made again

    def transition(self, x: Tensor, dt: TimeStep) -> tuple[Tensor, Tensor]:
        """Return the states (B, D) after dt, and the state transitions (B, D, D)."""
        return transition(self.flow, x, dt)

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (B, D) after dt."""
        if followed() or (isinstance(dt, Tensor) and dt.ndim):  # one step per member implies large batches
            return self.flow(x, dt)
        step = torch.as_tensor(dt, dtype=torch.float64)
        with _RECORDING:
            known = self._known.get(x.shape)
            if known is None:
                known = self._known[x.shape] = _record(lambda x, dt: self.flow(x, dt), x, step)
        return known(x, step)


class Increments:
    """Increments of dynamics for any parameters, without gradients; recorded if this saves time.

    A recording is shared by all problems with the same dynamics, which differ only in their parameters.

    Args:
        dynamics: float64 dynamics, which are not modified.
        calls: expected number of calls; the decision to record is based on it, so that results do not depend
            on earlier problems.
    """

    def __init__(self, dynamics: Dynamics, calls: int) -> None:
        self.dynamics = copy.deepcopy(dynamics).requires_grad_(False)
        self._original = dynamics
        self._wanted = calls > WORTH and self._gains()
        self._recorded: Callable[..., Tensor] | None = None
        self._theta: Tensor | None = None

    def _gains(self) -> bool:
        """Return whether a recording is faster; it is not for a step that is a single C operation.

        On a GPU the trace would be compiled anew for that device, which nobody has measured.
        """
        flow = self.dynamics
        on_cpu = next(flow.parameters()).device.type == "cpu"
        return on_cpu and is_fixed(flow) and not (isinstance(flow, HamiltonianDynamics) and flow.in_c())

    def __call__(self, theta: Tensor, x: Tensor, dt: Tensor) -> Tensor:
        """Return x(t + dt) - x(t), (B, D), for the parameters theta, (P,), states x, (B, D), and dt, (B,)."""
        if self._wanted:
            with _RECORDING:
                if self._recorded is None:
                    self._recorded = _recording(self._original, theta, x, dt)
            return self._recorded(theta, x, dt)
        if theta is not self._theta:
            vector_to_parameters(theta, self.dynamics.parameters())
            self._theta = theta
        return self.dynamics.increment(x, dt)


class _KnownFlow(NamedTuple):
    """Recording with the fixed properties of its dynamics: all except the parameters."""

    integrator: Any
    buffers: list[Tensor]
    recording: Callable[..., Tensor]

    def fits(self, dynamics: Dynamics) -> bool:
        """Return whether the dynamics still match the recording."""
        now = list(dynamics.buffers())
        if len(now) != len(self.buffers) or self.integrator is not getattr(dynamics, "integrator", None):
            return False
        pairs = zip(now, self.buffers, strict=True)
        return all(a.dtype == b.dtype and torch.equal(a, b) for a, b in pairs)


_KNOWN: WeakKeyDictionary[Dynamics, _KnownFlow] = WeakKeyDictionary()


def _recording(dynamics: Dynamics, *example: Tensor) -> Callable[..., Tensor]:
    """Return the recorded increment as a function of parameters, states and steps, made once per dynamics."""
    known = _KNOWN.get(dynamics)
    if known is None or not known.fits(dynamics):
        copied = copy.deepcopy(dynamics).requires_grad_(False)
        buffers = [buffer.clone() for buffer in dynamics.buffers()]
        known = _KnownFlow(
            getattr(dynamics, "integrator", None), buffers, _record(of_parameters(copied), *example)
        )
        _KNOWN[dynamics] = known
    return known.recording


def of_parameters(dynamics: Dynamics) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
    """Return the increment as a traceable function of parameters, states and steps; modifies the dynamics."""
    shapes = {name: p.shape for name, p in dynamics.named_parameters()}
    sizes = [shape.numel() for shape in shapes.values()]

    def increment(theta: Tensor, x: Tensor, dt: Tensor) -> Tensor:
        for (name, shape), part in zip(shapes.items(), theta.split(sizes), strict=True):
            owner, _, leaf = name.rpartition(".")
            dynamics.get_submodule(owner)._parameters[leaf] = part.view(shape)  # pyright: ignore[reportArgumentType]
        return dynamics.increment(x, dt)

    return increment


def _record(function: Callable[..., Tensor], *example: Tensor) -> Callable[..., Tensor]:
    with torch.inference_mode(mode=False), torch.no_grad(), warnings.catch_warnings():
        # torch.jit.trace is deprecated for deployment only, and no control flow here depends on values.
        warnings.simplefilter("ignore")
        trace: Any = torch.jit.trace
        known = trace(function, tuple(t.clone() for t in example), check_trace=False)
        for _ in range(SETTLED):
            known(*example)
    return known
