"""The pruner against an Optuna study: seeds, references, and that it keeps no state of its own."""

from __future__ import annotations

import optuna
import pytest
from optuna.trial import TrialState, create_trial

from ahnn_plugins.pfl.pruner import PFLPruner, final_loss, seed_series


def finished(losses: list[float], state: TrialState = TrialState.COMPLETE) -> optuna.trial.FrozenTrial:
    value = losses[-1] if state == TrialState.COMPLETE else None
    return create_trial(state=state, value=value, intermediate_values=dict(enumerate(losses)))


def study_of(count: int, state: TrialState = TrialState.COMPLETE) -> optuna.Study:
    study = optuna.create_study(pruner=PFLPruner(max_epochs=50))
    study.add_trials([finished([1.0, 0.1 * (k + 1)], state) for k in range(count)])
    return study


def test_should_prune_after_ten_epochs_against_ten_models():
    trial = study_of(10).ask()
    asked = []
    for epoch in range(11):
        trial.report(1.5, epoch)
        asked.append(trial.should_prune())
    assert asked == [False] * 9 + [True] * 2


@pytest.mark.parametrize(
    ("count", "state"), [(9, TrialState.COMPLETE), (20, TrialState.PRUNED), (20, TrialState.FAIL)]
)
def test_only_complete_trials_are_references(count: int, state: TrialState):
    trial = study_of(count, state).ask()
    for epoch in range(20):
        trial.report(9.9, epoch)
    assert not trial.should_prune()


def test_nan_prunes_in_an_empty_study():
    trial = study_of(0).ask()
    trial.report(float("nan"), 0)
    assert trial.should_prune()


def test_steps_of_several_seeds():
    values = {0: 3.0, 1: 2.0, 50: 5.0, 51: 4.0}
    assert seed_series(values, 50) == {0: [3.0, 2.0], 1: [5.0, 4.0]}
    assert final_loss(values, 50) == 3.0
