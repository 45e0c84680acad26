"""Dynamics trained in the user's own loop, saved as a run."""

from __future__ import annotations

from pathlib import Path

from ahnn.arguments import Positive, checked
from ahnn.checkpoints import FORMAT, Weights, write_weights
from ahnn.data.in_memory import check_space, check_states
from ahnn.dynamics import Dynamics
from ahnn.errors import UserError
from ahnn.loading import load, made
from ahnn.numbers import described
from ahnn.runs import Run
from ahnn.stored import SAVED, about_space
from ahnn.types import Space, Trajectories
from ahnn.uncertainty import find_domain


@checked
def save(
    dynamics: Dynamics, space: Space, dt: Positive, folder: str | Path, data: Trajectories | None = None
) -> Run:
    """Save trained dynamics as weights in float64, without scores, and return them as a run.

    `ahnn.load` and the commands that predict, assimilate and export accept the folder.

    Args:
        dynamics: dynamics built by `ahnn.Hamiltonian` or similar.
        space: names, units and inertia of the state components.
        dt: sampling interval of the training data, which is the longest step in predictions.
        folder: new folder.
        data: training trajectories, for `run.novelty`; without them novelty is unknown.

    Raises:
        UserError: a folder that is not empty, weights that are not finite, or a space or data with different
            states.
    """
    if not isinstance(dynamics, Dynamics) or not hasattr(dynamics, "spec"):
        message = f"dynamics: expected an ahnn.Hamiltonian or similar; received {described(dynamics)}"
        raise UserError(message)
    check_space(space)
    target, known = Path(folder), dynamics.frozen().cpu()
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        kind = "which contains files" if target.is_dir() else "a file"
        message = f"folder: expected a new folder; received {target}, {kind}"
        raise UserError(message)
    about = {"format": FORMAT, "dynamics": known.spec, "space": about_space(space), "dt": float(dt)}
    made(Weights(known.state_dict(), about), target)
    if data is not None:
        trajectories = check_states(data, space.dof)
        about["domain"] = find_domain(known, trajectories.states[trajectories.present]).about()
    write_weights(target / SAVED, Weights(known.state_dict(), about))
    return load(target)
