"""Calibration command: training runs on draws of truth, noise and weights, and the test of their bands."""

from __future__ import annotations

import contextlib
import json
import logging
import math
import random
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from ahnn.arguments import Count, Within
from ahnn.checkpoints import require_same
from ahnn.cli.early_stops import ended
from ahnn.cli.numbered_draws import SCORE, appearing, finished, run_missing, score
from ahnn.cli.pairs import read_pairs
from ahnn.errors import Occupied, TrainingError, UserError
from ahnn.evaluation.rank_test import rank_figure, rank_table
from ahnn.evaluation.terminal import show
from ahnn.files import require_writable, write_atomically

if TYPE_CHECKING:
    from ahnn.jobs.prepared import Prepared

log = logging.getLogger("ahnn")
FIGURE = "calibration.png"
OWN = ("plugins=none", "evaluation=scores", "logger=none")
DRAWN = ("run", "seed", "seeds", "data.seed", "ckpt")
"""Keys that differ from draw to draw."""
OTHERWISE = ("gravity", "mass")
"""Constants of which the first present one is drawn if a system lists none."""


@dataclass(frozen=True)
class CalibrationRequest:
    """Options of the command, without options of the training."""

    draws: Count = 20
    spread: Annotated[float, Within(0, 1)] = 0.1
    fitted: Annotated[float, Within(0, 1)] = 0.5
    samples: Annotated[int, Within(0)] = 0
    jobs: Count = 1
    output: str = "runs/calibration"
    only: list[Count] | None = None  # only these draws, counted from 1: set for worker processes


class CalibrationDraw(NamedTuple):
    """One draw: its number, counted from 1, and its folder."""

    number: int
    folder: Path


def calibrate(arguments: list[str]) -> None:
    """Train the unfinished draws, and show and plot the test of all draws.

    Raises:
        UserError: options that do not compose, or no training on measurements of a system.
        TrainingError: some training runs failed; all other runs are in the table.
    """
    keys = {field.name for field in fields(CalibrationRequest)}
    own = [text for text in arguments if text.partition("=")[0] in keys]
    overrides = [text for text in arguments if text not in own]
    for key in (text.partition("=")[0] for text in overrides):
        if key in DRAWN:
            message = (
                f"{key}: expected no value, since each draw has its own; received one. Use draws= and output="
            )
            raise UserError(message)
    asked = read_pairs(own or ["jobs=1"], CalibrationRequest)
    numbers = asked.only or range(1, asked.draws + 1)
    plan = [CalibrationDraw(number, Path(asked.output, f"draw_{number}")) for number in numbers]
    if asked.only is not None:
        several(plan, overrides, asked)
        return
    constants_of(overrides, asked.spread, 1)
    require_writable(Path(asked.output))
    require_same_settings(plan, settings_of(overrides, asked), asked.output)

    def words(part: Sequence[CalibrationDraw]) -> list[str]:
        numbers = ",".join(str(draw.number) for draw in part)
        own = [f"only=[{numbers}]", f"spread={asked.spread}", f"fitted={asked.fitted}"]
        here = [*own, f"samples={asked.samples}", f"output='{asked.output}'"]
        return ["ahnn.calibrate", *overrides, *here]

    log.info(
        "calibrate: %d draws in %s, %d of them finished", len(plan), asked.output, sum(map(finished, plan))
    )
    with ended(lambda: "repeat the command to resume"):
        failed = run_missing(plan, words, asked.jobs, shared=True)
    if scores := [score(draw) for draw in plan if finished(draw)]:
        show(rank_table(scores))
        rank_figure(scores).savefig(Path(asked.output, FIGURE), dpi=120)
    if failed:
        places = ", ".join(str(draw.number) for draw in failed)
        message = f"calibrate: {len(failed)} of {len(plan)} training runs failed, see above: draw {places}"
        raise TrainingError(message)


def settings_of(overrides: Sequence[str], asked: CalibrationRequest) -> dict[str, Any]:
    """Return what determines the results of a draw, as plain values."""
    own = {"spread": asked.spread, "fitted": asked.fitted, "samples": asked.samples}
    return {"training": sorted(overrides), **own}


def require_same_settings(plan: Sequence[CalibrationDraw], wanted: dict[str, Any], output: str) -> None:
    """Raise UserError if a finished draw was made with other settings."""
    for draw in filter(finished, plan):
        known = score(draw).get("settings", {})
        old, new = (
            whole | {"training": dict(text.partition("=")[::2] for text in whole.get("training", []))}
            for whole in (known, wanted)
        )
        require_same(f"draw {draw.folder}", old, new, f"Choose another folder than output={output}")


def constants_of(overrides: list[str], spread: float, number: int) -> list[str]:
    """Return the constants of the system in a draw, as overrides; raises UserError as `calibrate` does."""
    from ahnn.cli.compose import compose_job
    from ahnn.cli.parts import build_sensor, build_source

    cfg = compose_job([*overrides, *OWN], Path("unused"))
    source = build_source(cfg)
    if source.truth is None or build_sensor(cfg, source) is None:
        message = (
            "calibrate: expected simulated measurements of a system; received exact states or files. Add "
            "sensor= or data.noise=, or choose an experiment with noise, such as experiment=spring_noisy"
        )
        raise UserError(message)
    drawn = random.Random(number)
    own = type(source.truth).constants or [name for name in OTHERWISE if name in cfg.system][:1]
    names = own if spread else ()
    return [f"system.{name}={cfg.system[name] * math.exp(spread * drawn.gauss(0, 1))}" for name in names]


def several(plan: Sequence[CalibrationDraw], overrides: list[str], asked: CalibrationRequest) -> None:
    """Train and test draws one after another in this process; raises TrainingError if some failed."""
    failed = 0
    for draw in plan:
        try:
            one(draw, overrides, asked)
        except (TrainingError, UserError) as error:
            failed += 1
            log.info("draw %d: %s", draw.number, error)
    if failed:
        message = f"calibrate: {failed} of {len(plan)} draws failed, see above"
        raise TrainingError(message)


def one(draw: CalibrationDraw, overrides: list[str], asked: CalibrationRequest) -> None:
    """Train and test one draw in this process; its folder appears when both are done."""
    from ahnn.cli.compose import compose_job
    from ahnn.cli.preflight import quiet
    from ahnn.cli.settings import check_settings
    from ahnn.cli.training import train_once
    from ahnn.jobs.closing import bands_of

    constants = constants_of(overrides, asked.spread, draw.number)
    texts = [*overrides, *OWN, *constants, f"seed={draw.number}", f"data.seed={draw.number}"]
    with contextlib.suppress(Occupied), appearing(draw.folder) as place:
        cfg = compose_job(texts, place / "run")
        quiet()
        check_settings(cfg)
        found: dict[str, Any] = {"settings": settings_of(overrides, asked)}
        begun = time.process_time()

        def evaluation(prepared: Prepared, seconds: float) -> float:
            del seconds
            found.update(bands_of(prepared, asked.fitted, asked.samples))
            return 0.0

        train_once(cfg, None, texts, evaluation)
        if "forecast" not in found:
            message = "calibrate: expected bands and forecasts; received none: the model fits no trajectory"
            raise TrainingError(message)
        write_atomically(place / SCORE, json.dumps(found).encode())
        seconds = time.process_time() - begun
        log.info("draw %d: finished in %.0f s of processor time", draw.number, seconds)
