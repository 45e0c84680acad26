"""Models of a report: legend order, and slots that determine colour and dash."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import count
from pathlib import Path

from ahnn_plugins.report.collection import Collection, Entry

ORDER = ("MLP", "NODE", "HNN", "AHNN3", "AHNN5")
"""Models of the paper, as named in its tables."""
SLOTS = {name: slot for slot, name in enumerate(reversed(ORDER))}
"""The first slot belongs to AHNN5, which the paper proposes."""


def ordered(models: Sequence[str]) -> list[str]:
    """Return models in the order of the paper, followed by all other models."""
    known = [name for name in ORDER if name in models]
    return known + [m for m in models if m not in known]


def slots(collection: Collection) -> dict[str, int]:
    """Return the slot of every model of a report, common to all systems."""
    models = ordered(list(dict.fromkeys(entry.model for entry in collection.entries)))
    taken = {model: SLOTS[model] for model in models if model in SLOTS}
    free = (slot for slot in count() if slot not in taken.values())
    return {model: taken[model] if model in taken else next(free) for model in models}


def one_each(entries: Iterable[Entry]) -> list[Entry]:
    """Return the first evaluation of every run: additional evaluations add nothing to the spread of seeds."""
    chosen: dict[Path, Entry] = {}
    for entry in entries:
        chosen.setdefault(training_folder(entry), entry)
    return list(chosen.values())


def training_folder(entry: Entry) -> Path:
    """Return the run folder of an evaluation in `RUN/evaluations/NAME`."""
    folder = entry.folder
    return folder.parent.parent if folder.parent.name == "evaluations" else folder
