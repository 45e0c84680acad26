"""Training from Python on trajectories of one's own: `ahnn.fit`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ahnn.errors import UserError

if TYPE_CHECKING:
    from ahnn.runs import Run
    from ahnn.types import Space, Trajectories


def fit(
    trajectories: Trajectories, space: Space, overrides: Sequence[str] = (), *, folder: str | Path
) -> Run:
    """Train on trajectories that you have, evaluate on those held back, and return the run.

    The same code as `python -m ahnn.train`, with the same table and files. Nothing is known of the equations,
    so that floors and energy errors are left out, and plugins that need them must be asked for by name.

    Args:
        trajectories: states (B, T, 2n) and times (B, T) or (T,), NaN where a sample is absent.
        space: names, units and inertia of the state components.
        overrides: as on the command line, such as "model=hnn", "window=3", "trainer.max_epochs=50".
        folder: of the run, a new one.

    Raises:
        UserError: trajectories or overrides that make no training, or a folder with another one.
    """
    from ahnn.cli.before import quiet
    from ahnn.cli.compose import compose_job
    from ahnn.cli.settings import check_settings
    from ahnn.data import Given
    from ahnn.runs import about_space, load
    from ahnn.train import train_once

    source = Given(trajectories, space)
    if wrong := [o for o in overrides if o.split("=")[0].split(".")[0] in ("system", "run", "folder")]:
        message = f"fit: expected the data as `trajectories` and the folder as `folder`; received {wrong[0]}"
        raise UserError(message)
    quiet()
    cfg = compose_job(overrides, Path(folder))
    cfg.system = {"name": space.name, "given": about_space(space)}
    check_settings(cfg)
    train_once(cfg, source, overrides)
    return load(folder)
