"""Study of a sweep, and samplers of its trials."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from hydra.utils import instantiate
from omegaconf import DictConfig

from ahnn.errors import UserError
from hydra_plugins.ahnn_sweeper._storage import JOURNAL, exclusive, open_storage, resolved

if TYPE_CHECKING:
    import optuna


def url(storage: str | None, sweep_dir: Path) -> str:
    """Return the resolved storage, by default a journal file in the sweep folder."""
    return resolved(storage or f"{JOURNAL}{sweep_dir / 'study.journal'}")


def open_study(
    storage: str, name: str, direction: Literal["minimize", "maximize"], fixed: list[str]
) -> optuna.Study:
    """Create the study, or continue an existing study of the same sweep.

    Args:
        storage: resolved URL.
        name: name of the study.
        direction: `minimize` or `maximize`.
        fixed: overrides shared by all jobs; trials with different values of these are not comparable.

    Raises:
        UserError: if the study exists with another direction or other fixed overrides.
    """
    import optuna

    if direction not in ("minimize", "maximize"):
        message = f"sweeper: expected direction to be 'minimize' or 'maximize'; received {direction!r}"
        raise UserError(message)
    opened = open_storage(storage)
    with exclusive(storage):
        study = optuna.create_study(study_name=name, storage=opened, direction=direction, load_if_exists=True)
        wanted = {"fixed": sorted(fixed), "direction": direction}
        found = study.user_attrs.get("sweep")
        if found is None:
            study.set_user_attr("sweep", wanted)
        elif found != wanted:
            message = (
                f"study {name!r} in {storage.partition(':')[0]} storage: expected to be continued with "
                f"{found}; received {wanted}; repeat the first command, "
                "or choose another hydra.sweeper.study_name"
            )
            raise UserError(message)
    return study


def sampler(config: DictConfig, number: int) -> optuna.samplers.BaseSampler:
    """Return the sampler of one trial.

    A sampler restarted with the same seed would draw the same random trials again, and so would each worker.
    The number of the trial is therefore added to the seed, except for quasi-random sequences, whose members
    must share the seed.
    """
    from optuna.exceptions import ExperimentalWarning
    from optuna.samplers import QMCSampler

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        made = instantiate(config)
        if config.get("seed") is None or isinstance(made, QMCSampler):
            return made
        return instantiate(config, seed=int(config.seed) + number)
