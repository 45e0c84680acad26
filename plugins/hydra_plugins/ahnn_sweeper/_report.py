"""Results of a sweep: a table on the console, `best.yaml`, and Optuna's plots as PNG files."""

from __future__ import annotations

import logging
import math
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from hydra_plugins.ahnn_sweeper._best import write_best
from hydra_plugins.ahnn_sweeper._ledger import count, replaced

if TYPE_CHECKING:
    import optuna
    from hydra.core.config_loader import ConfigLoader
    from optuna.trial import FrozenTrial

logger = logging.getLogger(__name__)
_ROWS = 5  # number of best trials in the table


def write(study: optuna.Study, sweep_dir: Path, config_loader: ConfigLoader, groups: set[str]) -> int:
    """Write the results of a study.

    Args:
        study: the study.
        sweep_dir: folder for the files.
        config_loader: Hydra's loader.
        groups: the configuration groups of the application.

    Returns:
        The number of failed trials without a retry.
    """
    console = Console(stderr=True)
    trials = study.get_trials(deepcopy=False)
    console.print(_table(study, trials))
    if any(trial.state.name == "COMPLETE" for trial in trials):
        best = write_best(study, sweep_dir, config_loader, groups)
        _write_plots(study, sweep_dir)
        console.print(
            f"to run the best trial again: --config-dir {best.parent.parent} experiment={best.stem}"
        )
    return count(trials).failed


def _table(study: optuna.Study, trials: list[FrozenTrial]) -> Table:
    """Format the best trials and all failed ones, with reasons."""
    counts = count(trials)
    table = Table(
        title=f"{study.study_name}: {counts.complete} complete, {counts.pruned} pruned, "
        f"{counts.failed} failed, {counts.replaced} killed and retried"
    )
    for column in ("trial", "state", "value", "parameters or reason"):
        table.add_column(column, overflow="fold")
    complete = [trial for trial in trials if trial.state.name == "COMPLETE" and trial.value is not None]
    complete.sort(key=lambda trial: trial.value or 0.0, reverse=study.direction.name == "MAXIMIZE")
    for trial in complete[:_ROWS]:
        params = "  ".join(f"{key}={_short(value)}" for key, value in trial.params.items())
        table.add_row(str(trial.number), "complete", f"{trial.value:.5g}", params)
    for trial in trials:
        if trial.state.name == "FAIL":
            state = "retried" if trial.number in replaced(trials) else "failed"
            table.add_row(str(trial.number), state, "", str(trial.user_attrs.get("error", "unknown")))
    return table


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _spans_decades(study: optuna.Study) -> bool:
    """Return whether the values are positive and the largest is over 100 times the smallest."""
    values = [trial.value for trial in study.get_trials(deepcopy=False) if trial.state.name == "COMPLETE"]
    finite = [value for value in values if value is not None]
    return min(finite) > 0 and max(finite) > 100 * min(finite)


def _log10(trial: FrozenTrial) -> float:
    assert trial.value is not None
    return math.log10(trial.value)


def _write_plots(study: optuna.Study, sweep_dir: Path) -> None:
    """Write history, importance and parallel-coordinate plots; plots unsupported by the study are omitted.

    Values that span decades, such as losses, are plotted as logarithms to distinguish good trials.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from optuna.visualization import matplotlib as plots

    log = _spans_decades(study)
    options: dict[str, Any] = {"target": _log10, "target_name": "log10 of the value"} if log else {}
    makers: dict[str, Callable[[], Any]] = {
        "history": lambda: plots.plot_optimization_history(study).set_yscale("log" if log else "linear"),
        "importance": lambda: plots.plot_param_importances(study, **options),
        "parallel": lambda: plots.plot_parallel_coordinate(study, **options),
    }
    for name, make in makers.items():
        target = sweep_dir / f"{name}.png"
        unfinished = sweep_dir / f".{name}.{os.getpid()}.png"  # other workers may write the same plot
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                make()
                plt.gcf().savefig(unfinished, dpi=100, bbox_inches="tight")
                unfinished.replace(target)
            except (ValueError, RuntimeError, ImportError) as error:  # too few trials, all values equal, ...
                logger.info("no plot %s: %s", target.name, error)
            finally:
                plt.close("all")
