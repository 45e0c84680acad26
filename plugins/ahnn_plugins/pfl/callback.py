"""Lightning callback of the pruner: reports validation losses, logs decisions and stops the run.

With an Optuna trial the reference is the study and a stop raises `optuna.TrialPruned`. Without one (a plain
grid multirun) the reference is a record in the sweep folder and a stop ends the fit as early stopping does,
because Hydra counts an exception as a failed job. Without either, only a non-finite loss stops the run, but
decisions are still logged.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, Literal

import lightning as L
import optuna

from ahnn.errors import UserError
from ahnn.training.callbacks import require_monitored
from ahnn_plugins.pfl.decision import Decision, Settings, checked, decide
from ahnn_plugins.pfl.log import DecisionLog
from ahnn_plugins.pfl.predictor import FitName
from ahnn_plugins.pfl.pruner import PFLPruner
from ahnn_plugins.pfl.record import Record

logger = logging.getLogger(__name__)


class PFLCallback(L.Callback):
    """Stop a run whose Predicted Final Loss is worse than the final losses of the best complete runs.

    Each call of `fit` within a trial trains the next seed of that trial. `fit`, `use`, `fit_epochs`,
    `target_epoch` and `top_k` are described in `Settings`.

    Args:
        run_dir: folder of the run; decisions go to its `pfl.jsonl`.
        monitor: name of the metric reported after each validation epoch.
        trial: the `optuna.Trial` that this run belongs to, or its node in a configuration.
        record: file of final losses for runs without a trial; unused if its folder does not exist (a single
            run has no sweep folder).
        group: runs of different groups are never compared in the record.

    Raises:
        UserError: invalid settings.
    """

    def __init__(
        self,
        run_dir: str,
        monitor: str = "val/loss",
        fit: FitName = "log_linear",
        use: Literal["first", "all"] = "first",
        fit_epochs: int = 10,
        target_epoch: int = 50,
        top_k: int = 10,
        trial: optuna.Trial | None = None,
        record: str | None = None,
        group: str = "",
    ) -> None:
        self.settings = checked(Settings(fit, use, fit_epochs, target_epoch, top_k))
        self.run_dir = Path(run_dir)
        self.monitor = monitor
        self.trial = trial
        self.record = Record(Path(record), group) if record and Path(record).parent.is_dir() else None
        self.decision: Decision | None = None
        self._losses: list[float] = []
        self._restored: list[float] = []
        self._seed_index = 0
        self._max_epochs = 0

    def check(self, trainer: L.Trainer) -> None:
        """Raise UserError before training if the monitored metric will not be available."""
        require_monitored("callbacks.pfl.monitor", self.monitor, trainer)

    def on_fit_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Start the next series of the trial, or the only one of a run without a trial."""
        self._losses, self._restored = self._restored, []
        self.decision = None
        self._max_epochs = trainer.max_epochs or 0
        if self._max_epochs < 1:
            message = f"PFL callback: expected trainer.max_epochs >= 1; received {trainer.max_epochs}"
            raise UserError(message)
        if self.trial is not None:
            last = _frozen(self.trial).last_step
            self._seed_index = 0 if last is None else last // self._max_epochs + 1
        self._log = DecisionLog(self.run_dir / "pfl.jsonl", self.settings) if trainer.is_global_zero else None

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Report the loss, decide and possibly stop the run.

        Raises:
            optuna.TrialPruned: if the run belongs to a trial and the decision is to stop.
            UserError: if the monitored value was not logged.
        """
        if trainer.sanity_checking or trainer.state.fn != "fit":
            return
        if self.monitor not in trainer.callback_metrics:
            logged = ", ".join(sorted(trainer.callback_metrics)) or "nothing"
            message = (
                f"PFL callback: expected the model to log {self.monitor!r} in validation; it logged "
                f"{logged}; set callbacks.pfl.monitor"
            )
            raise UserError(message)
        prune = trainer.is_global_zero and self._judge(
            float(trainer.callback_metrics[self.monitor]), trainer.current_epoch
        )
        if trainer.strategy.reduce_boolean_decision(prune, all=False):
            self._stop(trainer)

    def on_fit_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Append the final loss of a complete run to the record."""
        complete = self._losses and not (self.decision and self.decision.prune)
        if self.record is not None and self.trial is None and trainer.is_global_zero and complete:
            self.record.append(str(self.run_dir), self._losses[-1])

    def state_dict(self) -> dict[str, Any]:
        """Return the losses so far, for a run that continues from its checkpoint."""
        return {"losses": list(self._losses)}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the losses of an interrupted run for the next fit."""
        self._restored = list(state_dict["losses"])

    def _judge(self, loss: float, epoch: int) -> bool:
        """Report, decide and log; return whether to stop."""
        self._losses.append(loss)
        finals: list[float] = []
        if self.trial is not None:
            pruner = PFLPruner(self._max_epochs, **self.settings._asdict())
            self.trial.report(loss, self._seed_index * self._max_epochs + epoch)
            finals = pruner.finals(self.trial.study)
            decision = pruner.decide_against(finals, _frozen(self.trial))
        else:
            finals = self.record.finals() if self.record is not None else []
            decision = decide([self._losses], finals, self.settings)
        assert self._log is not None
        self._log.append(self._seed_index, epoch, loss, finals, decision)
        self.decision = decision
        return decision.prune

    def _stop(self, trainer: L.Trainer) -> None:
        message = "stopped by the PFL pruner"
        if self.decision is not None:
            _, forecast, threshold, reason = self.decision
            message = (
                f"{message} after epoch {trainer.current_epoch}: {reason} "
                f"(forecast {forecast}, threshold {threshold})"
            )
        logger.info(message)
        if self.trial is not None:
            raise optuna.TrialPruned(message)
        trainer.should_stop = True


def _frozen(trial: optuna.Trial) -> optuna.trial.FrozenTrial:
    """Return the current state of the trial in the storage."""
    return next(t for t in trial.study.get_trials(deepcopy=False) if t.number == trial.number)
