"""Runs of a report, and their results."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from ahnn.errors import UserError
from ahnn.evaluation.results import FILE, Results, load_results
from ahnn_plugins.report.settings import SETTINGS, data_of, values_of

PREDICTIONS = "predictions.safetensors"
EVALUATIONS = "evaluations"
PAPER = ("mass_spring", "molniya")
"""Systems of the paper, in its order."""


class Entry(NamedTuple):
    """Run, or one of its evaluations.

    Attributes:
        folder: folder with metrics.json and, if predictions were kept, predictions.safetensors.
        results: content of metrics.json.
        system: name of the system, with the data file or unit if these differ between runs.
    """

    folder: Path
    results: Results
    system: str

    @property
    def model(self) -> str:
        """Name of the model in tables."""
        return self.results.label

    @property
    def seed(self) -> int | None:
        """Training seed, if known."""
        seed = self.results.training.get("seed")
        return seed if isinstance(seed, int) else None


class Collection(NamedTuple):
    """All runs of a report, ordered by folder.

    Attributes:
        entries: evaluated runs.
        unfinished: run folders with a configuration but no results.
    """

    entries: tuple[Entry, ...]
    unfinished: tuple[Path, ...] = ()

    def systems(self) -> list[str]:
        """Return the names of the systems, without duplicates, the paper's systems first."""
        names = dict.fromkeys(entry.system for entry in self.entries)
        return sorted(names, key=lambda name: PAPER.index(name) if name in PAPER else len(PAPER))

    def of(self, system: str, model: str | None = None) -> list[Entry]:
        """Return the runs of a system, or of one of its models."""
        return [e for e in self.entries if e.system == system and model in (None, e.model)]


def collect(folders: Iterable[Path]) -> Collection:
    """Collect the runs in folders, each of which is a run or contains runs at any depth.

    Later evaluations of a run in the same collection are omitted, since its seed would count twice.

    Raises:
        UserError: a folder contains no runs, or a damaged one.
    """
    found: dict[Path, Path] = {}
    unfinished: dict[Path, Path] = {}
    for folder in folders:
        inside = [folder] if (folder / FILE).is_file() else runs_below(folder)
        if not inside:
            what = f"no {FILE}. Evaluate the run first" if folder.exists() else "no such folder"
            message = f"{folder}: expected a run, or a folder of runs; received {what}"
            raise UserError(message)
        for each in inside:
            found.setdefault(each.resolve(), each)
        begun = (path.parent for path in sorted(folder.rglob(SETTINGS)))
        for each in begun:
            if not ((each / FILE).exists() or (each / EVALUATIONS).exists() or each.name == ".hydra"):
                unfinished.setdefault(each.resolve(), each)
    loaded = {folder: load_results(folder) for folder in found.values()}
    names = system_names(loaded)
    entries = tuple(Entry(folder, results, names[folder]) for folder, results in loaded.items())
    return Collection(entries, tuple(unfinished.values()))


def system_names(runs: dict[Path, Results]) -> dict[Path, str]:
    """Return the name of each run's system; equal names with different data or units are made distinct.

    Scores in different units, or of different objects, have no common mean.
    """
    files = {folder: data_of(values_of(folder)) for folder in runs}
    full = {folder: ", ".join(paths) for folder, paths in files.items()}
    short = {folder: ", ".join(Path(path).name for path in paths) for folder, paths in files.items()}
    data = short if len(set(short.values())) == len(set(full.values())) else full
    units = {f: f"{results.space.units.position}, {results.space.units.time}" for f, results in runs.items()}
    names = {folder: results.space.name for folder, results in runs.items()}
    return _distinct(_distinct(names, data, "{} ({})"), units, "{} [{}]")


def _distinct(names: dict[Path, str], values: dict[Path, str], form: str) -> dict[Path, str]:
    """Append their values to names whose runs have different values."""
    found: dict[str, set[str]] = {}
    for folder, name in names.items():
        found.setdefault(name, set()).add(values[folder])
    return {
        folder: form.format(name, values[folder] or "unknown data") if len(found[name]) > 1 else name
        for folder, name in names.items()
    }


def runs_below(folder: Path) -> list[Path]:
    """Return the folders with results below a folder, without later evaluations of a run."""
    found = sorted(path.parent for path in folder.rglob(FILE))
    later = {each for each in found if each.parent.name == EVALUATIONS and each.parent.parent in found}
    return [each for each in found if each not in later]
