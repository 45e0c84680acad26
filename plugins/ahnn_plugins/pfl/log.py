"""Log of the decisions with the values behind them, one JSON line each, and the replay of a log.

The first line of a fit contains the settings. Each further line contains one epoch: its loss, the reference
losses known at that time (at most `top_k`) and the decision. Non-finite numbers are strings, so that each
line is strict JSON.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, NamedTuple

from ahnn_plugins.pfl.decision import Decision, Settings, best_finals, decide


class Replayed(NamedTuple):
    """Logged decision and the decision recomputed from its numbers."""

    seed_index: int
    epoch: int
    logged: Decision
    replayed: Decision


class DecisionLog:
    """Append decisions to a file; the settings are written before the first one.

    Args:
        path: path of the file; its folder is created.
        settings: settings of the decisions.
    """

    def __init__(self, path: Path, settings: Settings) -> None:
        self.path = path
        self.settings = settings
        path.parent.mkdir(parents=True, exist_ok=True)
        self._write({"settings": settings._asdict()})

    def append(
        self, seed_index: int, epoch: int, loss: float, finals: list[float], decision: Decision
    ) -> None:
        """Add one epoch of one seed."""
        self._write(
            {
                "seed_index": seed_index,
                "epoch": epoch,
                "loss": loss if math.isfinite(loss) else str(loss),
                "finals": best_finals(finals, self.settings.top_k),
                "decision": decision._asdict(),
            }
        )

    def _write(self, row: dict[str, Any]) -> None:
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row, allow_nan=False) + "\n")


def replay(path: Path) -> list[Replayed]:
    """Recompute decisions from the numbers in a log.

    Args:
        path: a `pfl.jsonl` that the callback wrote.

    Returns:
        One entry per logged decision, in the order of the log.
    """
    settings = Settings()
    series: dict[int, list[float]] = {}
    entries = []
    new_fit = True
    for line in path.read_text(encoding="utf-8").splitlines():
        row = json.loads(line)
        if "settings" in row:
            settings, new_fit = Settings(**row["settings"]), True
            continue
        if new_fit:
            series.pop(row["seed_index"], None)
            new_fit = False
        series.setdefault(row["seed_index"], []).append(float(row["loss"]))
        now = decide(list(series.values()), row["finals"], settings)
        entries.append(Replayed(row["seed_index"], row["epoch"], Decision(**row["decision"]), now))
    return entries
