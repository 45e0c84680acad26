"""Training on user-supplied trajectories from Python: `ahnn.fit`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ahnn.errors import UserError

if TYPE_CHECKING:
    from ahnn.runs import Run
    from ahnn.types import Space, Trajectories


READ = ("system.cut", "system.gap", "system.unsound")
"""Keys of `system=files` that control how trajectories are used, available from Python too."""
ELSEWHERE = ("run", "folder", "seeds", "members", "sweep", "trial")
"""Keys of the command line that set the run folder and the number of models."""


def fit(
    trajectories: Trajectories, space: Space, overrides: Sequence[str] = (), *, folder: str | Path
) -> Run:
    """Train on given trajectories, evaluate on the test split, and return the run.

    Runs the code of `python -m ahnn.train system=files` and writes the same table and files. The values are
    exact states or, with `data.noise`, measurements, which imply `sensor=recorded` unless a sensor, recipe or
    loss is named. The true equations are unknown, so floors and energy errors are omitted, and plugins that
    need them must be requested by name. Progress goes to the logger `ahnn`.

    Args:
        trajectories: states (B, T, 2n) and times (B, T) or (T,), NaN marks missing samples; positions (B, T,
            n) where momenta are unknown.
        space: names, units and inertia of the state components.
        overrides: overrides as on the command line, such as "model=hnn", "window=3", "trainer.max_epochs=50".
        folder: new folder of the run.

    Raises:
        UserError: invalid trajectories or overrides, or a folder that contains another run.
    """
    from ahnn.arguments import check_arguments
    from ahnn.cli.compose import compose_job
    from ahnn.cli.guard import in_words
    from ahnn.cli.preflight import quiet, require_new
    from ahnn.cli.settings import check_settings
    from ahnn.cli.training import train_once
    from ahnn.data import Given
    from ahnn.loading import load
    from ahnn.stored import about_space

    texts = check_given(overrides, folder)
    with in_words():
        cfg = compose_job(["system=files", *texts], Path(folder))
        options = {key: cfg.system[key] for key in ("cut", "gap", "unsound")}
        check_arguments("system", Given, options, ("trajectories", "space"))
        source = Given(trajectories, space, **options)
        source.check()
        quiet()
        cfg.system = {"name": space.name, "given": about_space(space)}
        check_settings(cfg)
        require_new(Path(cfg.folder), cfg.ckpt)
        train_once(cfg, source, texts)
    return load(folder)


def check_given(overrides: Sequence[str], folder: str | Path) -> list[str]:
    """Return the validated overrides.

    Raises:
        UserError: an override is not a string or duplicates an argument, or the folder is missing.
    """
    from ahnn.cli.commandline import parse

    texts: list[Any] = (
        [*overrides] if isinstance(overrides, Iterable) and not isinstance(overrides, str) else [None]
    )
    if not all(isinstance(text, str) for text in texts):
        message = f"overrides: expected a list of strings such as ['model=hnn']; received {overrides!r}"
        raise UserError(message)
    if not isinstance(folder, str | Path) or str(folder) in ("", ".") or "\0" in str(folder):
        message = f"folder: expected the path of a new folder; received {folder!r}"
        raise UserError(message)
    for override in map(parse, texts):
        key = override.key_or_group
        if key not in READ and key.replace("/", ".").split(".")[0] in ("system", "hydra", *ELSEWHERE):
            message = (
                "fit: expected the data as `trajectories` and the folder as `folder`, and one training run; "
                f"received {override.input_line}"
            )
            raise UserError(message)
        if override.is_sweep_override():
            message = f"fit: expected one value, since it trains once; received {override.input_line}"
            raise UserError(message)
    return texts
