"""Biases of sensors: values that are none, filters under them, and what a training or an evaluation makes of them.

What is accepted is held against a Kalman filter of states and biases from the textbook.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import torch

from ahnn.assimilation import Assimilation, Reading, StreamSensor
from ahnn.cli.compose import compose_job
from ahnn.cli.prepare import prepare
from ahnn.estimation import initial_belief
from ahnn.measurements import Biases, GroundStation, Position, Several, State
from ahnn.types import Space, Units
from ahnn_plugins.ekf import ExtendedKalmanFilter
from ahnn_plugins.ukf import UnscentedKalmanFilter, online_process

from .children import TRAINING, trained
from .doors import answered, enter, taken

NAN, INF = math.nan, math.inf
SPACE = Space("cart", ("q", "p"), Units("s", "m", "m/s", "J"))
MODELS = {
    "position": (lambda: Position(3), 3, 0), "one": (lambda: Position(1), 1, 0), "state": (lambda: State(2), 4, 2),
    "station": (lambda: GroundStation(60.0, 30.0, range_rate=True), 4, 0),
    "stations": (lambda: Several([GroundStation(60.0, 30.0), GroundStation(10.0, 20.0)]), 6, 3),
}  # fmt: skip
"""Models, their M components, and how many numbers stand for all; 0 for none but one or M."""
ODD = [None, 0, 0.0, -1.0, NAN, INF, -INF, 1e150, 1e149, 1e-300, 1e-12, 0.5, 2, "a", "0.5", "", True, 1j, {}, {"a": 1}, object(), b"1",
       10**400, np.float64(0.5), np.array([0.5]), torch.tensor(0.5), [], (), [[1.0]], [None], ["a"], [True]]  # fmt: skip
SDS = {
    "0.5": "same", "[0.5]": "same", "[0.5,0.5,0.5]": "same", "5e-1": "same", "[0.5,.5,5.0e-1]": "same", "null": "none", "1e-12": "none",
    "[1e-12,0,1e-12]": "none", "[0.5,0,0]": "other", "0.6": "other", "[0.5,0.5,0.6]": "other", "1e3": "other", "0": "refused", "[0,0,0]": "refused",
    "-1": "refused", "[0.5,-0.5,0.5]": "refused", ".nan": "refused", ".inf": "refused", "[0.5,.nan,0.5]": "refused", "1e150": "refused",
    "a": "refused", "true": "refused", "[]": "refused", "[[1]]": "refused", "{a: 1}": "refused", "''": "refused", "[0.5,0.5]": "refused",
    "[0.5,0.5,0.5,0.5]": "refused", "[0.5,true,0.5]": "refused", "[0.5,null,0.5]": "refused", "'0.5'": "refused", "[0.5,'0.5',0.5]": "refused",
    "1e400": "refused", "99999999999999999999": "any", "1e149": "any", "1e-300": "any", "1e100": "any", "nan": "refused", "inf": "refused",
}  # fmt: skip
"""Values of `bias_sd`: `same` estimates as under 0.5, those of `none`, `other` ones, `any`, or `refused`."""
MEMORIES = {
    "60": "wanders", "60.0": "wanders", "[60,60,60]": "wanders", "[60]": "wanders", ".inf": "same", "null": "same", "1e300": "same",
    "[.inf,.inf,.inf]": "same", "61": "other", "[60,60,.inf]": "other", "0": "refused", "-1": "refused", ".nan": "refused", "a": "refused",
    "true": "refused", "[]": "refused", "[60,0,60]": "refused", "[60,60]": "refused", "{a: 1}": "refused", "-.inf": "refused", "1e-300": "any",
    "[60,null,60]": "refused", "''": "refused", "[[60]]": "refused", "'60'": "refused",
}  # fmt: skip
"""Values of `bias_memory` beside `bias_sd=0.5`; `wanders` are the estimates under 60."""
FILTER = ["plugins=ukf", "plugins.ukf.cadence=10", "plugins.ukf.process_noise=[1e-8,1e-8]"]


def cases(draw, folder):
    """Yield values of biases, and the door that they go through."""
    child = trained(folder / "run", "trainer.max_epochs=1")
    assert child.code() == 0, child.said()
    kinds = ["model"] * 6 + ["kalman"] * 4 + ["training"] * 3 + ["evaluation"]
    while True:
        kind, seed, place = draw.choice(kinds), draw.randrange(10**6), Path(tempfile.mkdtemp(dir=folder))
        if kind == "model":
            name, memory = draw.choice(list(MODELS)), None
            sd = some(draw)
            if draw.random() < 0.5:
                memory = draw.choice([some(draw), 60.0])
            yield f"{name}, {sd} {memory}", partial(believed, name, sd, memory)
        elif kind == "kalman":
            yield f"Kalman {seed}", partial(filtered, place, seed)
        else:
            sd, memory = drawn(draw)
            act = {"training": prepared, "evaluation": evaluated}[kind]
            yield f"{kind}, {sd} {memory}", partial(act, place, sd, memory)


def some(draw) -> object:
    """Return what may be given for biases."""
    count = draw.choice([0, 0, 1, 2, 3, 4, 6])
    return [draw.choice(ODD[:11] * 2 + [0.5] * 30) for _ in range(count)] if count else draw.choice(ODD)


def drawn(draw) -> tuple[str, str | None]:
    """Return texts of `bias_sd` and `bias_memory`."""
    return ("0.5", draw.choice(list(MEMORIES))) if draw.random() < 0.4 else (draw.choice(list(SDS)), None)


def becomes(sd: str, memory: str | None) -> str:
    """Return what must become of two texts, for positions of three components."""
    return SDS[sd] if memory is None else MEMORIES[memory]


def is_sound(sd: str, memory: str | None) -> bool:
    """Return whether the filter of a spring must take two texts."""
    return sd in ("0.5", "0.6", "[0.5]", "null") and memory in (None, "60")


def words_of(sd: str, memory: str | None) -> list[str]:
    """Return the words of a command line."""
    return [f"measurement.bias_sd={sd}", *([] if memory is None else [f"measurement.bias_memory={memory}"])]


def are(values: object) -> list | None:
    """Return plain numbers, None of what is none."""
    numbers = [*values] if isinstance(values, list | tuple) else [values]
    plain = all(isinstance(one, int | float) and not isinstance(one, bool) for one in numbers)
    return numbers if plain and numbers else None


def widened(numbers: list, size: int, block: int) -> list:
    """Return a number for each of M components."""
    if block == 2 and len(numbers) == 2:
        return [one for one in numbers for _ in range(size // 2)]
    return numbers * (size // len(numbers)) if len(numbers) in (1, block) else numbers


def believed(name, sd, memory) -> None:
    """Say biases of a model; they are those numbers, or refused."""
    make, size, block = MODELS[name]
    found = Biases.of(make(), sd, memory)
    if found is None:
        assert sd is None and memory is None, "dropped without a word"  # noqa: PT018
        return
    sds, memories = are(sd), [INF] if memory is None else are(memory)
    assert sds is not None and memories is not None, "accepted"  # noqa: PT018
    assert [*found.deviations] == widened(sds, size, block), f"other deviations {found.deviations}"
    assert [*found.memories] == widened(memories, size, block), f"other memories {found.memories}"
    assert all(0 <= one < INF for one in found.deviations) and any(found.deviations), "no deviations"  # noqa: PT018
    assert all(one > 0 for one in found.memories), "no memories"


ERROR = (0.1, 0.3, 0.05)
"""Standard deviations of a ruler, which sees positions, and of a radar, which sees positions and velocities."""
NOISE = np.diag([1e-4, 1e-4])


def assimilation(names, sd, memory, estimator) -> Assimilation:
    """A coasting body before two sensors with biases, in some order."""
    ruler = StreamSensor.of(
        Position(1, "m"), ERROR[0], SPACE, bias_sd=float(sd[0]), bias_memory=float(memory[0])
    )
    biases = {"bias_sd": sd[1:].tolist(), "bias_memory": memory[1:].tolist()}
    radar = StreamSensor.of(State(1, ("m", "m/s")), [*ERROR[1:]], SPACE, **biases)
    coasting = lambda x, dt: x @ torch.tensor([[1.0, 0.0], [dt, 1.0]], dtype=torch.float64)  # noqa: E731
    process, begin = online_process(estimator, coasting, 0.5, NOISE), np.diag([0.5, 0.2])
    sensors = {"ruler": ruler, "radar": radar}
    return Assimilation(process, {name: sensors[name] for name in names}, initial_belief([[1.0, 0.3]], begin))


def textbook(mean, cov, values, sees, error, sd, memory):
    """Mean and covariance of body and biases after half a second and a reading."""
    step = np.diag([1.0, 1.0, *np.exp(-0.5 / memory)])
    step[0, 1] = 0.5
    kick = np.diag([*NOISE.diagonal(), *(sd**2 * -np.expm1(-1.0 / memory))])
    mean, cov = step @ mean, step @ cov @ step.T + kick
    gain = cov @ sees.T @ np.linalg.inv(sees @ cov @ sees.T + np.diag(np.square(error)))
    return mean + gain @ (values - sees @ mean), cov - gain @ sees @ cov


def filtered(place: Path, seed: int) -> None:
    """Filter readings of two sensors with biases, half of them behind a saved state, and the same by the textbook."""
    draw = np.random.default_rng(seed)
    sd = 10.0 ** draw.uniform(-2, 1, 3)
    memory = np.where(draw.random(3) < 0.5, INF, 10.0 ** draw.uniform(0, 3, 3))
    estimator = ExtendedKalmanFilter() if seed % 2 else UnscentedKalmanFilter()
    filtering = assimilation(("ruler", "radar"), sd, memory, estimator)
    mean, cov = np.array([1.0, 0.3, 0, 0, 0]), np.diag([0.5, 0.2, *sd**2])
    for k in range(14):
        if k == 7:
            filtering.save(place / "a")
            names = ("radar", "ruler") if seed % 3 else ("ruler", "radar")
            filtering = assimilation(names, sd, memory, estimator)
            filtering.load(place / "a")
        name, rows, biased, error = (
            ("ruler", [0], [2], ERROR[:1]) if k % 3 else ("radar", [0, 1], [3, 4], ERROR[1:])
        )
        values = draw.normal(size=len(rows))
        filtering.update(Reading(0.5 * (k + 1), tuple(values.tolist()), name))
        sees = np.eye(5)[rows] + np.eye(5)[biased]
        mean, cov = textbook(mean, cov, values, sees, error, sd, memory)
    state = filtering.window.state.moments.mean[0, :2].numpy()
    told = [*filtering.biases["ruler"], *filtering.biases["radar"]]
    worst = np.abs(np.array([*state, *(value for value, _ in told)]) - mean) / np.sqrt(cov.diagonal())
    assert worst.max() < 1e-6, f"{worst.max():.1e} standard deviations off the Kalman filter"
    spread = np.array([one for _, one in told]) / np.sqrt(cov.diagonal()[2:])
    assert np.abs(spread - 1).max() < 1e-6, f"other deviations of biases, {spread}"


def prepared(place, sd, memory) -> None:
    """Do all that a training with a filter behind it does before it begins."""
    words = [*(word for word in TRAINING if not word.startswith("plugins")), *FILTER, *words_of(sd, memory)]
    with taken(is_sound(sd, memory)):
        prepare(compose_job(words, place / "run"), asked=())
    assert becomes(sd, memory) != "refused", "accepted"


def evaluated(place, sd, memory) -> None:
    """Evaluate a spring with a filter and biases."""
    run = shutil.copytree(place.parent / "run", place / "run")
    with taken(is_sound(sd, memory)):
        answered(*enter(place, "evaluate", f"run={run}", "name=again", *FILTER, *words_of(sd, memory)))
    assert becomes(sd, memory) != "refused", "accepted"
