"""Tensors and files: the same numbers reach a training as the same bits, by whatever door they came.

Trajectories are drawn, written as a table, and given as tensors of many types and layouts. What a training
would see of each split is compared between the two, and with the numbers themselves.
"""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch

import ahnn
from ahnn.cli import training
from ahnn.cli.compose import compose_job
from ahnn.cli.prepare import prepare
from ahnn.types import Space, Trajectories, Units

NAMES = {1: ("q",), 2: ("x", "y"), 3: ("x", "y", "z")}
SPLIT = "data.split=[0.6,0.2,0.2]"
EXACT = ["model=hnn", "loss.derivative=0", "plugins=none", "trainer.accelerator=cpu", "logger=none", SPLIT]
MEASURED = [*EXACT[2:], "sensor=recorded", "hamiltonian=mechanical", "data.noise=0.05"]
LAYOUTS = {
    "float64": lambda a: torch.tensor(a),
    "float32": lambda a: torch.tensor(a, dtype=torch.float32),
    "float16": lambda a: torch.tensor(a, dtype=torch.float16),
    "bfloat16": lambda a: torch.tensor(a, dtype=torch.bfloat16),
    "integers": lambda a: torch.tensor(a).long(),
    "transposed": lambda a: torch.tensor(a.swapaxes(0, -1).copy()).transpose(0, -1),
    "strided": lambda a: torch.tensor(np.repeat(a, 2, axis=-1))[..., ::2],
    "with gradients": lambda a: torch.tensor(a, requires_grad=True),
    "a parameter": lambda a: torch.nn.Parameter(torch.tensor(a)),
    "numpy": np.array,
    "numpy, Fortran": np.asfortranarray,
    "numpy, reversed": lambda a: a[::-1].copy()[::-1],
    "numpy, big-endian": lambda a: a.astype(">f8"),
    "numpy, single": lambda a: a.astype(np.float32),
    "numpy, read-only": lambda a: read_only(a.copy()),
    "numpy, objects": lambda a: a.astype(object),
    "masked": lambda a: np.ma.masked_invalid(np.where(np.isnan(a), np.nan, a)),
    "masked numbers": lambda a: np.ma.array(np.nan_to_num(a, nan=77.0), mask=np.isnan(a)),
    "lists": lambda a: a.tolist(),
    "a list of arrays": list,
    "sparse": lambda a: torch.tensor(a).to_sparse(),
    "long double": lambda a: a.astype(np.longdouble),
}
FORMATS = {"csv": ",", "tsv": "\t", "txt": ";", "parquet": ""}


def read_only(array: np.ndarray) -> np.ndarray:
    """Return an array that nobody may write."""
    array.flags.writeable = False
    return array


def cases(draw, folder):
    """Yield data, the layout of their tensor and the format of their file."""
    while True:
        what = {
            "n": draw.randint(1, 3),
            "kind": draw.choice(["exact", "noisy", "positions", "exact", "noisy"]),
            "irregular": draw.random() < 0.3,
            "gaps": draw.choice(["", "", "rows", "empty rows", "cells"]),
            "lengths": draw.random() < 0.3,
            "mass": draw.choice([1.0, 1.0, 2.0, 0.25]),
            "layout": draw.choice(list(LAYOUTS)),
            "format": draw.choice(list(FORMATS)),
            "one row of times": draw.random() < 0.3,
        }
        said = ", ".join(f"{key} {value}" for key, value in what.items() if value)
        yield said, partial(attempt, Path(tempfile.mkdtemp(dir=folder)), what, draw.randrange(10**6))


def attempt(place: Path, what: dict, seed: int) -> None:
    """Bring the same numbers through both doors."""
    times, states = drawn(what, np.random.default_rng(seed))
    lay = LAYOUTS[what["layout"]]
    given = lay(states)
    states = rounded(given, states)
    moments = lay(times) if "float64" in what["layout"] or what["layout"] == "numpy" else torch.tensor(times)
    if what["one row of times"] and not what["lengths"] and not what["irregular"]:
        moments = moments[0]
    n, names = what["n"], NAMES[what["n"]]
    space = Space(
        "mine", (*names, *(f"p{name}" for name in names)), Units("s", "m", "m/s", "J"), what["mass"]
    )
    written(place / f"mine.{what['format']}", times, states, what)
    words = EXACT if what["kind"] == "exact" else MEASURED
    theirs = of_files(place, words, what)
    if what["kind"] == "positions":
        given = lay(np.concatenate((states[..., :n], np.full_like(states[..., :n], np.nan)), axis=-1))
        words = [*words, "data.measured=position"]
    ours = of_tensors(place, words, Trajectories(given, moments), space)
    size = n if what["kind"] == "positions" else 2 * n
    begin = 0
    for name, a, b in zip(("train", "val", "test"), ours, theirs, strict=True):
        assert len(a[0]) == len(b[0]), f"{name}: {len(a[0])} and {len(b[0])} trajectories"
        for k in range(len(a[0])):
            whole = what["kind"] == "exact"
            same(f"{name} {k}, tensors beside files", seen(a, k, whole), seen(b, k, whole))
            truth = states[begin + k, :, :size]
            there = counted(truth, whole)
            known = times[begin + k][there], truth[there]
            same(f"{name} {k}, files beside the numbers", seen(b, k, whole), known)
        begin += len(a[0])


def drawn(what: dict, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return times (B, T) and states (B, T, 2n) of oscillators, NaN where something is missing."""
    count, samples, n = 15, 16, what["n"]
    steps = np.full((count, samples - 1), 0.125)
    if what["irregular"]:
        steps = steps * rng.uniform(0.6, 1.4, steps.shape)
    times = np.concatenate((np.zeros((count, 1)), steps.cumsum(1)), axis=1)
    phase, size = rng.uniform(0, 6, (count, 1, n)), rng.uniform(0.5, 2, (count, 1, n))
    angle = times[..., None] + phase
    states = np.concatenate((size * np.cos(angle), -what["mass"] * size * np.sin(angle)), axis=-1)
    if what["kind"] != "exact":
        states = states + 0.05 * rng.standard_normal(states.shape)
    if what["layout"] == "integers":
        states = np.round(8 * states)
    else:
        states = states.astype(np.float16).astype(np.float64) if "16" in what["layout"] else states
        states = states.astype(np.float32).astype(np.float64) if "32" in what["layout"] else states
    if what["gaps"] and what["layout"] != "integers":
        rows = rng.integers(4, 9, count)
        for b, k in enumerate(rows):
            states[b, k, slice(None) if "rows" in what["gaps"] else rng.integers(n)] = np.nan
    if what["lengths"]:
        for b in range(0, count, 3):
            states[b, -3:], times[b, -3:] = np.nan, np.nan
    return times, states


def rounded(given: object, states: np.ndarray) -> np.ndarray:
    """Return the numbers that a tensor of less digits holds."""
    if isinstance(given, torch.Tensor) and given.dtype.is_floating_point and not given.is_sparse:
        return given.detach().double().numpy()
    if isinstance(given, np.ndarray) and given.dtype == np.float32:
        return given.astype(np.float64)
    return states


def written(path: Path, times: np.ndarray, states: np.ndarray, what: dict) -> None:
    """Write a table of the numbers: momenta, or positions alone."""
    names = NAMES[what["n"]]
    size = len(names) if what["kind"] == "positions" else 2 * len(names)
    head = ["id", "t [s]", *(f"{q} [m]" for q in names), *(f"p{q} [kg m/s]" for q in names)][: 2 + size]
    rows = []
    for b, (t, x) in enumerate(zip(times, states, strict=True)):
        for k in range(len(t)):
            gone = np.isnan(x[k]).all()
            if not np.isnan(t[k]) and not (gone and what["gaps"] == "rows" and not what["irregular"]):
                rows.append([f"t{b}", float(t[k]), *map(float, x[k, :size])])
    if path.suffix == ".parquet":
        import pyarrow
        import pyarrow.parquet

        columns = {name: [row[k] for row in rows] for k, name in enumerate(head)}
        pyarrow.parquet.write_table(pyarrow.table(columns), path)
        return
    mark = FORMATS[path.suffix[1:]]
    lines = [mark.join("" if cell != cell else str(cell) for cell in row) for row in rows]
    path.write_text("\n".join([mark.join(head), *lines]) + "\n")


def of_files(place: Path, words: list[str], what: dict) -> list[Trajectories]:
    """Return what a training would see of the file."""
    path = place / f"mine.{what['format']}"
    more = ["system=files", f"system.path={path}", f"system.mass={what['mass']}", "system.unsound=true"]
    cfg = compose_job([*more, *words], place / "a")
    return splits(prepare(cfg, asked=()).data)


def of_tensors(place: Path, words: list[str], data: Trajectories, space: Space) -> list[Trajectories]:
    """Return what a training from Python would see."""
    found = []

    def instead(cfg, source=None, *_):
        found.extend(splits(prepare(cfg, source, ()).data))
        raise StopIteration

    with patch.object(training, "train_once", instead):
        try:
            ahnn.fit(data, space, words, folder=place / "b")
        except StopIteration:
            return found
    message = "fit came back without a training"
    raise AssertionError(message)


def splits(data) -> list[Any]:
    """Return what training sees of each split, states or measurements."""
    found = data.splits
    return [
        found[name] if found.sensor is None else found.measured(name) for name in ("train", "val", "test")
    ]


def counted(values: np.ndarray, whole: bool) -> np.ndarray:
    """Return which samples count: whole ones of exact states, any with a number of measurements."""
    return np.isfinite(values).all(1) if whole else np.isfinite(values).any(1)


def seen(data: Any, k: int, whole: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return times and values of the samples of a trajectory that count."""
    values, times = (part[k].numpy() for part in data[:2])
    there = counted(values, whole) & np.isfinite(times)
    return times[there], values[there]


def same(who: str, one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> None:
    """Assert the same bits."""
    for name, a, b in zip(("times", "values"), one, other, strict=True):
        assert a.shape == b.shape, f"{who}: {name} of shape {a.shape} and {b.shape}"
        equal = np.array_equal(a, b, equal_nan=True)
        assert equal, (
            f"{who}: {name} differ by up to {np.nanmax(abs(a - b)):.3g}, NaN {np.isnan(a).sum()}, {np.isnan(b).sum()}"
        )
