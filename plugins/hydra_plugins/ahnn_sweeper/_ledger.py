"""Bookkeeping of trials: allotment, counting, and retry of orphans.

An orphan is a RUNNING trial whose process is gone. It is set to FAIL and its parameters are enqueued again,
marked `retry_of`; the retry replaces it. A trial is retried until its job has started twice. If a kill
interrupts a step, the next worker that holds the lock completes it and never repeats it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from hydra_plugins.ahnn_sweeper._owner import is_alive, runs_elsewhere, this_process
from hydra_plugins.ahnn_sweeper._storage import exclusive

if TYPE_CHECKING:
    import optuna
    from optuna.distributions import BaseDistribution
    from optuna.trial import FrozenTrial

logger = logging.getLogger(__name__)
_STARTS = 2  # a job is started at most twice


class Counts(NamedTuple):
    """Number of trials by state; those replaced by a retry are counted as `replaced` only."""

    complete: int
    pruned: int
    failed: int
    running: int
    waiting: int
    replaced: int

    @property
    def finished(self) -> int:
        """Trials that need no more work."""
        return self.complete + self.pruned + self.failed

    @property
    def taken(self) -> int:
        """Trials out of the total that are finished, running or waiting."""
        return self.finished + self.running + self.waiting


def count(trials: Sequence[FrozenTrial]) -> Counts:
    """Count the trials of a study by their state."""
    gone = replaced(trials)
    states = [trial.state.name for trial in trials if trial.number not in gone]
    return Counts(
        complete=states.count("COMPLETE"),
        pruned=states.count("PRUNED"),
        failed=states.count("FAIL"),
        running=states.count("RUNNING"),
        waiting=states.count("WAITING"),
        replaced=len(gone),
    )


def replaced(trials: Sequence[FrozenTrial]) -> set[int]:
    """Return the numbers of trials replaced by a retry."""
    return {trial.user_attrs["retry_of"] for trial in trials if "retry_of" in trial.user_attrs}


def allot(
    study: optuna.Study,
    url: str,
    space: Mapping[str, BaseDistribution],
    sampler_for: Callable[[int], optuna.samplers.BaseSampler],
    total: int,
    limit: int,
) -> list[optuna.Trial]:
    """Allot up to `limit` remaining trials, after requeueing orphans.

    Args:
        study: the study.
        url: resolved URL of its storage.
        space: parameters and their distributions.
        sampler_for: function from a trial number to the sampler of the trial.
        total: total number of trials of the study.
        limit: maximum number of trials to allot.

    Returns:
        The trials, marked as requested by this process; none if all are finished or taken.
    """
    taken = []
    with exclusive(url):
        _recover(study)
        while len(taken) < limit:
            known = study.get_trials(deepcopy=False)
            counts = count(known)
            if counts.taken >= total and not counts.waiting:
                break
            study.sampler = sampler_for(_next_number(known))
            trial = study.ask(dict(space))
            trial.set_user_attr("asked_by", this_process())
            taken.append(trial)
    return taken


def _next_number(trials: Sequence[FrozenTrial]) -> int:
    """Return the number of the next trial of the study: the first waiting one, or a new one.

    A retry of an orphan without parameters draws them, with its own number added to the seed.
    """
    return min((trial.number for trial in trials if trial.state.name == "WAITING"), default=len(trials))


def settle(study: optuna.Study, url: str, numbers: Sequence[int], all_ended: bool) -> None:
    """Requeue launched trials whose jobs were killed before they reported.

    Args:
        study: the study.
        url: resolved URL of its storage.
        numbers: the launched trials.
        all_ended: whether the launcher waited for all jobs. If not, those still running elsewhere (a cluster
            continues other jobs when one dies) report by themselves.
    """
    with exclusive(url):
        for trial in study.get_trials(deepcopy=False):
            if trial.number in numbers and not trial.state.is_finished():
                if not all_ended and runs_elsewhere(trial):
                    continue
                _put_back(study, trial)


def _recover(study: optuna.Study) -> None:
    """Requeue every RUNNING trial whose process has ended."""
    for trial in study.get_trials(deepcopy=False):
        if trial.state.name == "RUNNING" and not is_alive(trial):
            _put_back(study, trial)


def _put_back(study: optuna.Study, trial: FrozenTrial) -> None:
    """Mark an orphan as FAIL, and enqueue its parameters again if its job may be started once more.

    The retry is enqueued first, so that a kill between the two steps leaves an orphan that already has its
    retry.
    """
    from optuna.trial import TrialState

    starts = trial.user_attrs.get("starts_before", 0) + ("run_by" in trial.user_attrs)
    others = study.get_trials(deepcopy=False)
    has_retry = any(other.user_attrs.get("retry_of") == trial.number for other in others)
    if starts < _STARTS and not has_retry:
        study.enqueue_trial(trial.params, user_attrs={"retry_of": trial.number, "starts_before": starts})
    study._storage.set_trial_user_attr(trial._trial_id, "error", "killed: its process ended without a result")
    study.tell(trial.number, state=TrialState.FAIL)
    again = "retried" if starts < _STARTS else "not retried again"
    logger.warning("trial %d was killed before it had a result; %s", trial.number, again)


def any_started(study: optuna.Study, numbers: Sequence[int]) -> bool:
    """Return whether any job of these trials began; if none did, the launcher has failed."""
    trials = study.get_trials(deepcopy=False)
    return any(trial.number in numbers and "run_by" in trial.user_attrs for trial in trials)
