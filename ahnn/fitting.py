"""Training from Python on trajectories of one's own: `ahnn.fit`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ahnn.errors import UserError

if TYPE_CHECKING:
    from ahnn.runs import Run
    from ahnn.types import Space, Trajectories


READ = ("system.cut", "system.gap", "system.unsound")
"""Keys of `system=files` that say how trajectories are taken, from Python too."""
ELSEWHERE = ("run", "folder", "seeds", "sweep", "trial")
"""Keys that say where the command line trains, and how many models."""


def fit(
    trajectories: Trajectories, space: Space, overrides: Sequence[str] = (), *, folder: str | Path
) -> Run:
    """Train on trajectories that you have, evaluate on those held back, and return the run.

    The same code as `python -m ahnn.train system=files`, with the same table and files: the numbers are
    exact states, or measurements where `data.noise` says so, as `sensor=recorded` takes them. Nothing is
    known of the equations, so that floors and energy errors are left out, and plugins that need them must be
    asked for by name.

    Args:
        trajectories: states (B, T, 2n) and times (B, T) or (T,), NaN where a sample is absent; positions
            (B, T, n) where momenta are unknown.
        space: names, units and inertia of the state components.
        overrides: as on the command line, such as "model=hnn", "window=3", "trainer.max_epochs=50".
        folder: of the run, a new one.

    Raises:
        UserError: trajectories or overrides that make no training, or a folder with another one.
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
    """Return overrides.

    Raises:
        UserError: they are no texts, or say what arguments say; or there is no folder.
    """
    from ahnn.cli.commandline import parse

    texts: list[Any] = (
        [*overrides] if isinstance(overrides, Iterable) and not isinstance(overrides, str) else [None]
    )
    if not all(isinstance(text, str) for text in texts):
        message = f"overrides: expected a list of texts such as ['model=hnn']; received {overrides!r}"
        raise UserError(message)
    if not isinstance(folder, str | Path) or str(folder) in ("", ".") or "\0" in str(folder):
        message = f"folder: expected the path of a new folder; received {folder!r}"
        raise UserError(message)
    for override in map(parse, texts):
        key = override.key_or_group
        if key not in READ and key.replace("/", ".").split(".")[0] in ("system", "hydra", *ELSEWHERE):
            message = (
                "fit: expected the data as `trajectories` and the folder as `folder`, and one training; "
                f"received {override.input_line}"
            )
            raise UserError(message)
        if override.is_sweep_override():
            message = f"fit: expected one value, since it trains once; received {override.input_line}"
            raise UserError(message)
    return texts
