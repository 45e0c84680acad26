"""Commands as users type them, each in a forked process and a folder of its own, and what becomes of them."""

from __future__ import annotations

import importlib
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from ahnn.errors import UserError

from .children import Child, command, plain

LIMIT = 60.0
"""Seconds after which a command hangs."""
MODEL = "pretrained=molniya_mechanical"
START = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]
"""A state of the model, at periapsis: km and km/s."""
NOISE = "plugins.ukf.process_noise=[1e-3,1e-5]"
"""A process noise of one's own: nothing is simulated to fit one."""
FIXES = [
    (60.0, 599.6, -3138.2, -6159.7),
    (120.0, 1196.6, -3118.1, -6120.1),
    (180.0, 1788.5, -3084.8, -6054.5),
]
"""Times in s and positions in km, close to the orbit from the start."""
DOORS = ("train", "evaluate", "predict", "assimilate", "report", "reproduce", "export", "data.__main__")


@cache
def warm() -> None:
    """Import what the doors import, once for all forked processes."""
    for name in (*(f"ahnn.{door}" for door in DOORS), "ahnn.graphs", "ahnn.prediction.output", "ahnn.loading",
                 "ahnn.assimilation.session", "ahnn.cli.stream", "ahnn.cli.reevaluation", "ahnn.cli.parts",
                 "ahnn.data.doctor", "ahnn.evaluation.make_case", "ahnn.data.starts", "ahnn_plugins.ukf"):  # fmt: skip
        importlib.import_module(name)


def enter(place: Path, door: str, *words: str, limit: float = LIMIT) -> tuple[int, str]:
    """Return exit code and words of a command that runs in a folder of its own beside `place`."""
    warm()
    home = place / "home"
    home.mkdir(parents=True, exist_ok=True)
    os.environ["AHNN_CACHE"] = str(place.parent / "cache")
    run = command(f"ahnn.{door}", *words)

    def work() -> None:
        os.chdir(home)
        run()

    child = Child(work, place / "log")
    return child.code(limit), child.said()


def answered(code: int, said: str, codes: Sequence[int] = (0, 2, 3)) -> None:
    """Assert an end that a user can understand; raises UserError for a refusal."""
    plain(said)
    assert code in codes, f"exit code {code}: {said[-300:]}"
    if code:
        assert said.strip(), f"exit code {code} without a message"
        raise UserError(said)


@contextmanager
def taken(sound: bool) -> Iterator[None]:
    """Let a refusal of sound data be a failure."""
    try:
        yield
    except UserError as error:
        if sound:
            message = f"sound data are refused: {error}"
            raise AssertionError(message) from error
        raise


def numbers(values: Sequence[float]) -> str:
    """Return numbers as a command line takes them."""
    return "[" + ",".join(map(spelled, values)) + "]"


def spelled(value: float) -> str:
    """Return a number as YAML reads it."""
    if math.isnan(value):
        return ".nan"
    return ("-" if value < 0 else "") + ".inf" if math.isinf(value) else repr(value)


def fixes(
    path: Path, rows: Sequence[Sequence[object]] = FIXES, head: str = "time [s],x [km],y [km],z [km]"
) -> Path:
    """Write measurements and return their file."""
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


def assimilating(measurements: Path, *more: str) -> list[str]:
    """Return the words that follow measurements with the shipped model; later words replace earlier ones."""
    words = [MODEL, f"measurements={measurements}", "measurement.sd=0.1", f"start={numbers(START)}"]
    words += ["start_sd=[1,0.001]", NOISE, "epoch=2024-03-01T12:00:00"]
    keys = {word.partition("=")[0] for word in more}
    if any(word.startswith("+measurement@sensors.") for word in more):  # which say it themselves
        keys |= {"measurement.sd"}
    return [*(word for word in words if word.partition("=")[0] not in keys), *more]
