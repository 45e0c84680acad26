"""Stateless Optuna pruner, which reads everything from the study.

It therefore survives restarts and works with many processes and machines. Seeds of a trial are distinguished
by the step: step = seed_index * max_epochs + epoch.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

from optuna.pruners import BasePruner
from optuna.study import Study
from optuna.trial import FrozenTrial, TrialState

from ahnn_plugins.pfl.decision import Decision, Settings, checked, decide
from ahnn_plugins.pfl.predictor import FitName


class PFLPruner(BasePruner):
    """Stop a trial whose forecast is worse than the worst final loss of the best complete trials.

    PRUNED and FAIL trials are ignored as references. See `Settings` for the arguments that are not listed.

    Args:
        max_epochs: number of epochs per seed, the stride between the steps of two seeds.

    Raises:
        UserError: invalid settings.
    """

    def __init__(
        self,
        max_epochs: int,
        fit: FitName = "log_linear",
        use: Literal["first", "all"] = "first",
        fit_epochs: int = 10,
        target_epoch: int = 50,
        top_k: int = 10,
    ) -> None:
        self.max_epochs = max_epochs
        self.settings = checked(Settings(fit, use, fit_epochs, target_epoch, top_k))

    def prune(self, study: Study, trial: FrozenTrial) -> bool:
        """Return whether to prune the trial."""
        return self.decide(study, trial).prune

    def decide(self, study: Study, trial: FrozenTrial) -> Decision:
        """Return the decision that `prune` uses, with its numbers."""
        return self.decide_against(self.finals(study), trial)

    def decide_against(self, finals: list[float], trial: FrozenTrial) -> Decision:
        """Return the decision on a trial, compared with the final losses of complete trials."""
        own = list(seed_series(trial.intermediate_values, self.max_epochs).values())
        return decide(own, finals, self.settings)

    def finals(self, study: Study) -> list[float]:
        """Return the final loss, averaged over the seeds, of every COMPLETE trial that reported losses."""
        complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        reported = [trial.intermediate_values for trial in complete if trial.intermediate_values]
        return [final_loss(values, self.max_epochs) for values in reported]


def seed_series(intermediate: Mapping[int, float], max_epochs: int) -> dict[int, list[float]]:
    """Return the losses of each seed in order of epochs, keyed by the index of the seed."""
    series: dict[int, list[float]] = {}
    for step in sorted(intermediate):
        series.setdefault(step // max_epochs, []).append(intermediate[step])
    return series


def final_loss(intermediate: Mapping[int, float], max_epochs: int) -> float:
    """Return the mean over the seeds of their last losses."""
    lasts = [losses[-1] for losses in seed_series(intermediate, max_epochs).values()]
    return math.fsum(lasts) / len(lasts)
