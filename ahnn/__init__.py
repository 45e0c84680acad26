"""Learn Hamiltonian dynamics from data, and assimilate measurements.

    # a run folder, or the name of a model shipped with the package
    run = ahnn.load("molniya_mechanical")
    run.rollout(start, steps=1440), run.energy(x), run.plot(), run.results

    # states (B, T, 2n) and times (B, T), NaN marks missing samples
    data = ahnn.Trajectories(states, times)
    space = ahnn.Space("cart", ("q", "p"))
    run = ahnn.fit(data, space, ["model=hnn"], folder="runs/cart")

    # a torch module, for your own training loop
    model = ahnn.Hamiltonian(dof=1, hidden=64, data=data)
    run = ahnn.save(model, space, dt=0.1, folder="runs/mine")

`python -m ahnn` lists the commands.
"""

from __future__ import annotations

import os
import sys

# Before any other import: `python -m` puts the working directory first on the path, so modules in it would be
# imported in place of libraries and as plugins. The directory may belong to another user
# (docs/extending.md).
_names_us = any(word.removeprefix("-m").partition(".")[0] == __name__ for word in sys.orig_argv[1:])
_is_command = _names_us and sys.argv[:1] == ["-m"]  # while `-m` looks up its module
if _is_command and not sys.flags.safe_path:
    del sys.path[0]
    os.environ["PYTHONSAFEPATH"] = "1"  # for the worker processes of a sweep
if _is_command:  # until `cli.guard` installs its handlers, Ctrl-C ends this process without a traceback
    import signal

    signal.signal(signal.SIGINT, signal.SIG_DFL)

from importlib import import_module  # noqa: E402
from typing import TYPE_CHECKING, Any  # noqa: E402

if TYPE_CHECKING:
    from ahnn.assimilation import Assimilation
    from ahnn.ensembles import Ensemble, load_ensemble
    from ahnn.errors import TrainingError, UserError
    from ahnn.fitting import fit
    from ahnn.loading import load
    from ahnn.papers import citations
    from ahnn.runs import Run
    from ahnn.saving import save
    from ahnn.types import Space, Trajectories, Units
    from ahnn.untrained import FlowMap, Hamiltonian, Lagrangian, NeuralODE

__version__ = "0.2.0"

HOMES = {
    "Assimilation": "assimilation",
    "Ensemble": "ensembles",
    "FlowMap": "untrained",
    "Hamiltonian": "untrained",
    "Lagrangian": "untrained",
    "NeuralODE": "untrained",
    "Run": "runs",
    "Space": "types",
    "TrainingError": "errors",
    "Trajectories": "types",
    "Units": "types",
    "UserError": "errors",
    "citations": "papers",
    "fit": "fitting",
    "load": "loading",
    "load_ensemble": "ensembles",
    "save": "saving",
}
"""Module of each public name; modules are imported on first use."""

__all__ = [
    "Assimilation",
    "Ensemble",
    "FlowMap",
    "Hamiltonian",
    "Lagrangian",
    "NeuralODE",
    "Run",
    "Space",
    "TrainingError",
    "Trajectories",
    "Units",
    "UserError",
    "__version__",
    "citations",
    "fit",
    "load",
    "load_ensemble",
    "save",
]


def __getattr__(name: str) -> Any:
    if name not in HOMES:
        message = f"module 'ahnn' has no attribute {name!r}"
        raise AttributeError(message)
    return getattr(import_module(f"ahnn.{HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
