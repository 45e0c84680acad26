"""The runs of a report: their results, and their arrays where a figure asks for them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from safetensors import safe_open
from torch import Tensor

from ahnn.errors import UserError
from ahnn.evaluation.results import FILE, Results, load_results

PREDICTIONS = "predictions.safetensors"


class Entry(NamedTuple):
    """A run, or one evaluation of it.

    Attributes:
        folder: with metrics.json, and where predictions were kept, predictions.safetensors.
        results: what metrics.json says.
    """

    folder: Path
    results: Results

    @property
    def system(self) -> str:
        """Name of the system."""
        return self.results.space.name

    @property
    def model(self) -> str:
        """Name of the model in tables."""
        return self.results.label

    @property
    def seed(self) -> int | None:
        """Seed of the training, where it is known."""
        return self.results.training.get("seed")

    def array(self, key: str) -> Tensor | None:
        """Return an array of the evaluation, such as `truth`, (B, T, D); None where it was not kept."""
        path = self.folder / PREDICTIONS
        if not path.is_file():
            return None
        with safe_open(str(path), "pt") as arrays:
            return arrays.get_tensor(key) if key in arrays.keys() else None  # noqa: SIM118 - no mapping


class Collection(NamedTuple):
    """All runs of a report, in the order of their folders."""

    entries: tuple[Entry, ...]

    def systems(self) -> list[str]:
        """Return the names of the systems, each once."""
        return list(dict.fromkeys(entry.system for entry in self.entries))

    def models(self, system: str) -> list[str]:
        """Return the names of the models of a system, each once."""
        return list(dict.fromkeys(entry.model for entry in self.of(system)))

    def of(self, system: str, model: str | None = None) -> list[Entry]:
        """Return the runs of a system, or those of one model of it."""
        return [e for e in self.entries if e.system == system and model in (None, e.model)]


def collect(folders: Iterable[Path]) -> Collection:
    """Return the runs in folders: each is a run, or holds runs at any depth.

    Raises:
        UserError: a folder holds none, or one of them is damaged.
    """
    found: list[Path] = []
    for folder in folders:
        inside = [folder] if (folder / FILE).is_file() else sorted(p.parent for p in folder.rglob(FILE))
        if not inside:
            message = f"{folder}: expected a run, or a folder of runs; received no {FILE}. Evaluate first"
            raise UserError(message)
        found += [each for each in inside if each not in found]
    return Collection(tuple(Entry(folder, load_results(folder)) for folder in found))
