"""A campaign of faults: hostile cases drawn from a seed, and what became of them.

    python tests/campaign/run.py --seed 0 --cases 3000 [--family NAME]

A case is answered when it works or ends in one clear refusal (`UserError`, exit code 2). It fails when it
ends in a traceback or not at all, accepts damaged data, calls or looks up what a file names, changes a file of
somebody's, or gives another result without a word.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import logging
import os
import random
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parent)]
os.environ["PYTHONUNBUFFERED"] = "1"

import torch
from families import (
    biased_streams,
    biases_values,
    caches,
    changes,
    checkpoints,
    commands,
    controls_arrays,
    controls_tables,
    disks,
    doors_files,
    environments,
    fields_elements,
    fields_messages,
    fields_parquet,
    fields_runs,
    fields_states,
    fields_tables,
    filters,
    finite_infinite,
    folders,
    foreign,
    kills,
    resumed,
    scales,
    signals,
    states,
    step_maps,
    tensors_files,
    trajectories,
)

from ahnn.cli.preflight import quiet
from ahnn.errors import TrainingError, UserError

FAMILIES: dict[str, tuple[Callable, float]] = {
    "configuration": (commands.cases, 0.1),
    "checkpoints, damaged": (checkpoints.cases, 0.045),
    "checkpoints, resumed": (resumed.cases, 0.035),
    "run folders": (foreign.cases, 0.05),
    "caches": (caches.cases, 0.04),
    "kills": (kills.cases, 0.035),
    "signals": (signals.cases, 0.015),
    "disks": (disks.cases, 0.015),
    "environments": (environments.cases, 0.01),
    "filter inputs": (filters.cases, 0.055),
    "saved states": (states.cases, 0.015),
    "trajectories": (trajectories.cases, 0.03),
    "silent changes": (changes.cases, 0.03),
    "doors x foreign files": (doors_files.cases, 0.07),
    "fields x messages": (fields_messages.cases, 0.05),
    "fields x tables": (fields_tables.cases, 0.05),
    "fields x element sets": (fields_elements.cases, 0.02),
    "fields x Parquet": (fields_parquet.cases, 0.02),
    "fields x runs": (fields_runs.cases, 0.05),
    "fields x streams": (fields_states.cases, 0.02),
    "folders that act": (folders.cases, 0.01),
    "tensors x files": (tensors_files.cases, 0.03),
    "finite x infinite": (finite_infinite.cases, 0.04),
    "scales": (scales.cases, 0.05),
    "controls x tables": (controls_tables.cases, 0.03),
    "controls x arrays": (controls_arrays.cases, 0.03),
    "maps and forces": (step_maps.cases, 0.02),
    "biases": (biases_values.cases, 0.02),
    "streams x biases": (biased_streams.cases, 0.015),
}
"""Families, and the fraction of the cases that each has: few where a case is a training."""
ANSWERS = ("worked", "refused", "failed")


def main() -> int:
    """Run a campaign; return 1 where a case failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cases", type=int, default=3000)
    parser.add_argument("--family", default="")
    options = parser.parse_args()
    quiet()
    torch.set_num_threads(1)  # a pool of threads does not survive a fork
    say(f"{'family':22}{'cases':>7}{''.join(f'{answer:>9}' for answer in ANSWERS)}{'seconds':>9}")
    total: Counter[str] = Counter()
    for name, (cases, fraction) in FAMILIES.items():
        if options.family in name:
            total += campaign(name, cases, round(fraction * options.cases), options.seed)
    say(row("all", total, 0))
    return int(total["failed"] > 0)


def campaign(name: str, cases: Callable, count: int, seed: int) -> Counter[str]:
    """Run the cases of a family, print its counts and failures, and return the counts."""
    answers: Counter[str] = Counter()
    started = time.monotonic()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        for what, case in drawn(cases, count, seed, Path(folder)):
            answer, why = judged(case)
            answers[answer] += 1
            if answer == "failed":
                say(f"  FAILED {name}: {what}: {why}")
    logging.getLogger("ahnn").setLevel(logging.NOTSET)  # some families are silent, the next one listens
    say(row(name, answers, time.monotonic() - started))
    return answers


def row(name: str, answers: Counter[str], seconds: float) -> str:
    """Return a row of the table."""
    counts = "".join(f"{answers[answer]:9}" for answer in ANSWERS)
    return f"{name:22}{sum(answers.values()):7}{counts}{seconds:9.0f}"


def drawn(cases: Callable, count: int, seed: int, folder: Path) -> Iterator[tuple[str, Callable[[], None]]]:
    """Yield `count` cases, the name of each and what to call."""
    source = cases(random.Random(seed), folder)
    for _ in range(count):
        yield next(source)


def judged(case: Callable[[], None]) -> tuple[str, str]:
    """Return how a case ended: worked, refused or failed, and why it failed."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            case()
    except (UserError, TrainingError, ValueError) as error:
        text = str(error)
        plain = isinstance(error, UserError) or "expected" in text
        return ("refused", "") if plain and text.strip() else ("failed", f"a poor refusal: {error!r}")
    except SystemExit as stop:
        return ("refused", "") if stop.code == 2 else ("failed", f"exit code {stop.code}")
    except BaseException as error:  # a campaign hears of everything
        text = " ".join(traceback.format_exception_only(error)).strip()
        return "failed", text if len(text) < 700 else f"{text[:200]} ... {text[-400:]}"
    return "worked", ""


def say(text: str) -> None:
    """Write a line at once: a campaign takes minutes."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
