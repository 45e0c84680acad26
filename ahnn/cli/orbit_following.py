"""Command line with `orbit=FILE.yaml`: a stream that continues an orbit determination."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ahnn.arguments import check_arguments, nearest
from ahnn.cli.build import build_all, plain_config
from ahnn.cli.compose import composed
from ahnn.cli.orbit_file import read_orbit
from ahnn.cli.stream_gate import AskedGate, with_gate
from ahnn.cli.unused_keys import refuse, unread_online
from ahnn.errors import UserError
from ahnn.estimation import RecursiveEstimator
from ahnn.evaluation import EvaluationPlugin
from ahnn.evaluation.estimators import EstimatorEvaluation
from ahnn.jobs.assimilation_request import AssimilationRequest, Stream, require_places
from ahnn.jobs.orbit_stream import OrbitFollowing, orbit_stream

FOREIGN = (
    "objects",
    "shard",
    "workers",
    "states",
    "controls",
    "sensors",
    "epoch",
    "frame",
    "center",
    "time_system",
    "time",
)
"""Keys of a stream that an orbit determination sets itself or does not use."""
DEFAULT = "plugins=ukf"


def read_following(arguments: list[str]) -> Stream:
    """Return the stream requested by a command line.

    Raises:
        UserError: a missing file, an unknown key, or incompatible options.
        TrainingError: the start is to be fitted, and no state fits.
    """
    given = ["watch=true" if argument == "--watch" else argument for argument in arguments]
    own = composed("assimilate", [])
    of_orbit, filters, mine = list[str](), list[str](), list[str]()
    for text in given:
        key, _, below = text.partition("=")[0].partition(".")
        if key not in (*own, "plugins"):
            hint = nearest(key, [*own, "plugins"])
            message = f"{key}: expected a key that applies with orbit=; received one that does not{hint}"
            raise UserError(message)
        chosen = filters if key == "plugins" else of_orbit if key == "orbit" and below else mine
        chosen.append(text.removeprefix("orbit.") if chosen is of_orbit else text)
    options = plain_config(composed("assimilate", mine))
    if foreign := [key for key in FOREIGN if options[key] not in (None, {})]:
        message = f"{foreign[0]}: expected none with orbit=, which sets it; received {options[foreign[0]]}"
        raise UserError(message)
    folder = [] if options["folder"] is None else [f"folder={options['folder']}"]
    orbit = read_orbit([options["orbit"], *folder, *of_orbit])
    other = options["measurements"]
    options["measurements"] = other or str(orbit.folder / orbit.setup.measurements)
    check_arguments("", AssimilationRequest, options)
    asked = AssimilationRequest(**options)
    require_places(asked)
    estimator, noise = filter_of(filters, asked.gate)
    place = None if other is None else Path(other).expanduser().resolve()
    return orbit_stream(asked, OrbitFollowing(orbit.setup, orbit.folder, estimator, noise, place))


def filter_of(overrides: list[str], gate: AskedGate) -> tuple[RecursiveEstimator[Any], tuple[float, float]]:
    """Return the estimator named on a command line, and the process noise per minute.

    Raises:
        UserError: no estimator or several, or a process noise fitted to a model.
    """
    texts = overrides if any(text.startswith("plugins=") for text in overrides) else [DEFAULT, *overrides]
    cfg = composed("train", texts, partly=True)
    refuse(unread_online(cfg.plugins, covariance=False, named=True), overrides)
    plugins = build_all(cfg.plugins, "plugins", EvaluationPlugin)
    filters = [one for one in plugins.values() if isinstance(one, EstimatorEvaluation)]
    if len(filters) != 1:
        received = ", ".join(plugins) or "none"
        message = f"plugins: expected one that filters online, such as {DEFAULT}; received {received}"
        raise UserError(message)
    noise = filters[0].process_noise
    if noise == "fitted":  # the default; with known forces there is nothing to fit
        noise = (0.0, 0.0)
    if not isinstance(noise, tuple | list):
        message = (
            "process_noise: expected [POSITION,VELOCITY], the standard deviations added per minute in km and "
            f"km/s; received {noise}"
        )
        raise UserError(message)
    return with_gate(filters[0].estimator, filters[0], gate), (noise[0], noise[1])
