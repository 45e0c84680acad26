"""Status line of a sweep: best value, running, pruned, failed, time left."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import timedelta
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.text import Text

from hydra_plugins.ahnn_sweeper._ledger import count

if TYPE_CHECKING:
    import optuna
    from optuna.trial import FrozenTrial

_REFRESH = 0.5  # updates per second; each one reads the study


class Progress:
    """Show the line while the sweep runs: in place on a terminal, else once per batch.

    Args:
        study: the study.
        total: total number of trials.
    """

    def __init__(self, study: optuna.Study, total: int) -> None:
        self._study = study
        self._total = total
        self._console = Console(stderr=True)
        self._live = Live(
            console=self._console, get_renderable=self._line, refresh_per_second=_REFRESH, transient=True
        )
        self._last = ""

    def __enter__(self) -> Progress:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._console.is_terminal:
            self._live.stop()

    def update(self) -> None:
        """Print the line if it has changed and cannot be refreshed in place."""
        line = self._line()
        if not self._console.is_terminal and line.plain != self._last:
            self._last = line.plain
            self._console.print(line, soft_wrap=True)

    def _line(self) -> Text:
        direction = self._study.direction.name
        return Text(progress_line(self._study.get_trials(deepcopy=False), self._total, direction))


def progress_line(trials: Sequence[FrozenTrial], total: int, direction: str) -> str:
    """Return the line.

    Args:
        trials: all trials of the study.
        total: total number of trials.
        direction: `MINIMIZE` or `MAXIMIZE`.
    """
    counts = count(trials)
    values = [trial.value for trial in trials if trial.state.name == "COMPLETE" and trial.value is not None]
    best = f"{min(values) if direction == 'MINIMIZE' else max(values):.4g}" if values else "-"
    return (
        f"sweep {counts.finished}/{total}  best {best}  running {counts.running}  pruned {counts.pruned}  "
        f"failed {counts.failed}  left {_time_left(trials, total)}"
    )


def _time_left(trials: Sequence[FrozenTrial], total: int) -> str:
    """Estimate the time for the remaining trials from the mean duration and current parallelism."""
    counts = count(trials)
    ended = [trial for trial in trials if trial.state.name in ("COMPLETE", "PRUNED")]
    durations = [trial.duration.total_seconds() for trial in ended if trial.duration is not None]
    if not durations:
        return "unknown"
    mean = sum(durations) / len(durations)
    seconds = mean * max(0, total - counts.finished) / max(1, counts.running)
    return str(timedelta(seconds=round(seconds)))
