"""Construction of source, sensor and plugins, shared by training and evaluation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from ahnn.arguments import check_arguments
from ahnn.cli.build import build, build_all, plain_config
from ahnn.data import Simulated, Source, SplitData
from ahnn.data.files.recordings import Recordings
from ahnn.data.recorded_sensor import Recorded
from ahnn.data.sensor import Sensor
from ahnn.data.sources import Observed
from ahnn.errors import UserError
from ahnn.systems import System
from ahnn.types import Space

if TYPE_CHECKING:
    from ahnn.evaluation import EvaluationPlugin

SIMULATION = ("trajectories", "seed", "cache")
"""Keys of `data` for the number of simulated trajectories and their cache."""
FILES = ("ahnn.data.files.Files", "ahnn.tracking.sightings.Sightings")
"""Sources of `system` that read files of unknown equations."""
SENSOR = {"measured": None, "noise": None, "every": 1, "stride": 1, "gaps": 0, "outliers": 0}
SENSOR |= {"bias_sd": None, "correlation": None, "tails": None, "freedom": None}
"""Keys of `data` for the sensor of training, each with the value that has no effect."""


def build_source(cfg: DictConfig) -> Source:
    """Build the source of trajectories: a simulated system, or a reader."""
    built = build(cfg.system, "system")
    if isinstance(built, Recordings):
        built.check()
    if not isinstance(built, System):
        return built
    options = {name: cfg.data[name] for name in SIMULATION if name in cfg.data}
    check_arguments("data", Simulated, options, ("system",))
    source = Simulated(built, **options)
    source.check()
    return source


def known_system(cfg: DictConfig) -> System | None:
    """Return the system with known equations of a configuration; None for files, which are not read."""
    if str(cfg.system.get("_target_", "")) in FILES:
        return None
    return build_source(cfg).truth


def build_sensor(cfg: DictConfig, source: Source) -> Sensor | None:
    """Build the sensor of training, simulated or recorded; None for exact states.

    Raises:
        UserError: options that do not fit the data.
    """
    data = plain_config(cfg.data)
    # Runs of older versions lack some keys.
    options: dict[str, Any] = {name: data.get(name, value) for name, value in SENSOR.items()}
    if isinstance(noise := options["noise"], str) and noise != "estimate":
        unit = "" if isinstance(source, Observed) else f" in {source.space.units.position}"
        message = f"data.noise: expected a number{unit}, a list of numbers, or estimate; received {noise!r}"
        raise UserError(message)
    if isinstance(source, Recordings | Observed):
        return build_recorded(options, source)
    measured = options["measured"] or "state"
    options["measured"] = measured if isinstance(measured, str) else build(cfg.data.measured, "data.measured")
    if options["noise"] is None:
        options["noise"] = getattr(options["measured"], "deviations", None)
    if options["noise"] is None:
        options["measured"] = data.get("measured")
        if given := {name: value for name, value in options.items() if value not in (None, SENSOR[name])}:
            message = f"data.noise: expected standard deviations with {given}; received null"
            raise UserError(message)
        return None
    check_arguments("data", Sensor, options, ("space", "seed"))
    return Sensor(source.space, **options, seed=cfg.data.seed)


def build_recorded(options: dict[str, Any], source: Recordings | Observed) -> Recorded | None:
    """Build the sensor of recorded data; None for exact states.

    Raises:
        UserError: positions without their noise, or options that apply only to simulated measurements.
    """
    kept = {
        name: options.pop(name) for name in ("measured", "noise", "stride", "bias_sd", "correlation", "tails")
    }
    measured, noise = kept["measured"], kept["noise"]
    drawn = [f"data.{name}={value}" for name, value in options.items() if value not in (None, SENSOR[name])]
    if drawn or not (measured is None or isinstance(measured, str)):
        message = (
            "data: expected only measured=state or measured=position, since nothing is added to recorded "
            f"measurements; received {', '.join(drawn) or 'data.measured=' + str(measured)}"
        )
        raise UserError(message)
    if isinstance(source, Observed):
        return build_sighted(kept, source)
    if noise is None and not source.positions_only and measured is None:
        return None
    if noise is None or (source.positions_only and measured == "state"):
        known = _positions_read(source.space) if source.positions_only else f"data.measured={measured}"
        message = (
            "data.noise: expected the standard deviations of the measurements and, if only positions are "
            "measured, a model with known kinetic energy, such as hamiltonian=mechanical; "
            f"received {known}, data.noise={noise}"
        )
        raise UserError(message)
    kind = measured or ("position" if source.positions_only else "state")
    options = {**kept, "measured": kind}
    check_arguments("data", Recorded, options, ("space", "every", "gaps", "outliers", "freedom", "seed"))
    return Recorded(source.space, **options)


def _positions_read(space: Space) -> str:
    """Return what was read as positions without momenta, since columns may be missing by mistake."""
    names = space.components[: space.dof]
    columns = f"{len(names)} column" + "s" * (len(names) > 1)
    read = f"{columns} read as {', '.join(names)} of a space with {len(space.components)} components"
    return f"only positions ({read})"


def build_sighted(options: dict[str, Any], source: Observed) -> Recorded:
    """Build the sensor of station measurements, with the noise and the biases of the file unless given.

    Raises:
        UserError: `data.measured` requests other measurements.
    """
    seen = source.sensors()
    if options["measured"] is not None:
        message = (
            "data.measured: expected null, since the measurements come from stations; received "
            f"{options['measured']}"
        )
        raise UserError(message)
    biased = seen.bias_sd if any(seen.bias_sd) else None
    options |= {"measured": seen, "noise": options["noise"] or seen.deviations}
    options["bias_sd"] = biased if options["bias_sd"] is None else options["bias_sd"]
    check_arguments("data", Recorded, options, ("space", "every", "gaps", "outliers", "freedom", "seed"))
    return Recorded(source.space, **options)


def build_plugins(nodes: DictConfig, splits: SplitData) -> dict[str, EvaluationPlugin]:
    """Build the evaluations that run after training, and check each against the data."""
    from ahnn.evaluation import EvaluationPlugin

    plugins = build_all(nodes, "plugins", EvaluationPlugin)
    source = splits.source
    for name, plugin in plugins.items():
        try:
            plugin.check(source.truth, source.space, source.steps())
        except UserError as error:
            message = f"plugins.{name}: {error}"
            raise UserError(message) from error
    return plugins


def report_options(asked: DictConfig) -> dict[str, Any]:
    """Return the report options of the node `evaluation`."""
    detail = asked.get("detail", False)  # absent in runs of earlier versions
    return {"predictions": asked.save_predictions, "figures": asked.figures, "detail": detail}


def is_one_of_several(folder: str) -> bool:
    """Return whether the training in a folder is one of several: of a sweep, or of several seeds."""
    return is_multirun() or (HydraConfig.initialized() and folder != HydraConfig.get().runtime.output_dir)


def is_multirun() -> bool:
    """Return whether this job is one of several."""
    return HydraConfig.initialized() and HydraConfig.get().mode is RunMode.MULTIRUN
