"""Trial of a job: lookup, and report of its outcome to the study."""

from __future__ import annotations

import logging
import math
import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.utils import JobStatus
from hydra.experimental.callback import Callback

from hydra_plugins.ahnn_sweeper._owner import Lease, this_process
from hydra_plugins.ahnn_sweeper._storage import open_storage

if TYPE_CHECKING:
    import optuna
    from hydra.core.utils import JobReturn
    from omegaconf import DictConfig

logger = logging.getLogger(__name__)

MARK = Path(".hydra", "pruned")
"""File that marks the folder of a pruned job, for the table of the sweep."""


def load_trial(storage: str, study_name: str, trial_id: int) -> optuna.Trial:
    """Load the trial of this job.

    Args:
        storage: resolved URL of the storage.
        study_name: name of the study.
        trial_id: the storage's id of the trial.
    """
    import optuna

    # Constructing a trial calls its sampler; the random sampler draws nothing here and has no side effect.
    sampler = optuna.samplers.RandomSampler()
    study = optuna.load_study(study_name=study_name, storage=open_storage(storage), sampler=sampler)
    return optuna.Trial(study, trial_id)


class TrialCallback(Callback):
    """Hydra callback that claims the trial at the start of a job and reports its outcome at the end.

    It runs in the process of the job, with any launcher, so that outcomes are stored immediately and are not
    lost if the sweep is killed. Jobs without a trial are ignored.
    """

    def __init__(self) -> None:
        self._trial: optuna.Trial | None = None
        self._lease: Lease | None = None

    def on_job_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Claim the trial, which is now alive as long as this process."""
        node = config.get("trial")
        if node is None or not _speaks():
            return
        self._trial = load_trial(node.storage, node.study_name, node.trial_id)
        self._trial.set_user_attr("run_by", this_process())
        self._lease = Lease(open_storage(node.storage), [node.trial_id])
        self._lease.__enter__()

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: Any) -> None:
        """Report the outcome of the trial to the study, and mark the folder of a pruned job."""
        if self._trial is None or self._lease is None:
            _forgive_pruning(job_return)
            return
        trial, self._trial = self._trial, None
        self._lease.__exit__()
        if job_return.status == JobStatus.FAILED:
            if _tell_exception(trial, job_return):
                _mark(Path(config.hydra.runtime.output_dir))
        else:
            _tell_value(trial, job_return._return_value)


def _tell_value(trial: optuna.Trial, value: Any) -> None:
    """Store a finite number as COMPLETE, anything else as FAIL."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if math.isfinite(number):
        trial.study.tell(trial.number, number, skip_if_finished=True)
    else:
        _fail(trial, f"the job returned {value!r}, expected a finite number")


def _speaks() -> bool:
    """Return whether this is the first process of its job; on several devices, only this one has a trial."""
    return all(os.environ.get(name, "0") == "0" for name in ("LOCAL_RANK", "RANK", "SLURM_PROCID"))


def _forgive_pruning(job_return: JobReturn) -> bool:
    """Return whether a job was pruned; Hydra then counts it as complete."""
    import optuna

    if not isinstance(job_return._return_value, optuna.TrialPruned):
        return False
    job_return.status, job_return._return_value = JobStatus.COMPLETED, None
    return True


def _mark(folder: Path) -> None:
    """Mark the folder of a pruned job, unless it has no folder `.hydra`."""
    with suppress(OSError):
        (folder / MARK).touch()


def _tell_exception(trial: optuna.Trial, job_return: JobReturn) -> bool:
    """Store pruning as PRUNED and any other exception as FAIL; return whether the trial was pruned."""
    import optuna

    error = job_return._return_value
    if _forgive_pruning(job_return):
        trial.study.tell(trial.number, state=optuna.trial.TrialState.PRUNED, skip_if_finished=True)
        return True
    logger.error("trial %d failed", trial.number, exc_info=error)
    text = str(error).partition("\n")[0]
    _fail(trial, f"{type(error).__name__}: {text}")
    return False


def _fail(trial: optuna.Trial, reason: str) -> None:
    from optuna.exceptions import UpdateFinishedTrialError
    from optuna.trial import TrialState

    try:
        trial.set_user_attr("error", reason)
    except UpdateFinishedTrialError:  # another worker considered this process dead
        return
    trial.study.tell(trial.number, state=TrialState.FAIL, skip_if_finished=True)
