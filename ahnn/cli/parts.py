"""From a configuration to the parts of a training; nothing is generated yet: mistakes show at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import check_arguments, flatten
from ahnn.checkpoints import FORMAT
from ahnn.cli.build import build, build_all, plain_config
from ahnn.data import Simulated, Source, SplitData
from ahnn.data.files.recordings import Recordings
from ahnn.data.recorded import Recorded
from ahnn.data.sensor import Sensor
from ahnn.errors import UserError
from ahnn.memory import require_memory
from ahnn.shooting.robust import ROBUST, RobustName
from ahnn.stored import about_space
from ahnn.systems import System

if TYPE_CHECKING:
    from lightning import Trainer

    from ahnn.data.datamodule import WindowDataModule
    from ahnn.evaluation import EvaluationPlugin
    from ahnn.models import AbstractModel
    from ahnn.runs import Run

SIMULATION = ("trajectories", "seed", "cache")
"""Keys of `data` that say how many trajectories are simulated, and where they are kept."""
SENSOR = {"measured": None, "noise": None, "every": 1, "stride": 1, "gaps": 0, "outliers": 0}
"""Keys of `data` that say what training sees of the trajectories, with the values that change nothing."""


def build_source(cfg: DictConfig) -> Source:
    """Build where the trajectories come from: a system is simulated, anything else reads by itself."""
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


def build_data(cfg: DictConfig, source: Source) -> WindowDataModule:
    """Build the DataModule of a training."""
    left_out = (*SIMULATION, *SENSOR)
    options = {key: value for key, value in plain_config(cfg.data).items() if key not in left_out}
    sensor = build_sensor(cfg, source)
    return build(OmegaConf.create(options), "data", source=source, window=cfg.window, sensor=sensor)


def build_sensor(cfg: DictConfig, source: Source) -> Sensor | None:
    """Build what training sees of trajectories, drawn or in files; None where it sees their states."""
    data = plain_config(cfg.data)
    # Runs of older versions lack some of the keys.
    options: dict[str, Any] = {name: data.get(name, value) for name, value in SENSOR.items()}
    if isinstance(source, Recordings):
        return build_recorded(options, source)
    if options["noise"] is None:
        if given := {name: value for name, value in options.items() if value not in (None, SENSOR[name])}:
            message = f"data.noise: expected standard deviations with {given}; received null"
            raise UserError(message)
        return None
    measured = options["measured"] or "state"
    options["measured"] = measured if isinstance(measured, str) else build(cfg.data.measured, "data.measured")
    check_arguments("data", Sensor, options, ("space", "seed"))
    return Sensor(source.space, **options, seed=cfg.data.seed)


def build_recorded(options: dict[str, Any], source: Recordings) -> Recorded | None:
    """Build what gave recorded numbers; None where they are exact states.

    Raises:
        UserError: positions without their noise, or what is drawn onto simulated measurements alone.
    """
    measured, noise, stride = (options.pop(name) for name in ("measured", "noise", "stride"))
    drawn = [f"data.{name}={value}" for name, value in options.items() if value not in (None, SENSOR[name])]
    if drawn or not (measured is None or isinstance(measured, str)):
        message = (
            "data: expected measured=state or position with recorded measurements, onto which nothing is "
            f"drawn; received {', '.join(drawn) or 'data.measured=' + str(measured)}"
        )
        raise UserError(message)
    if noise is None and not source.positions_only and measured is None:
        return None
    if noise is None or (source.positions_only and measured == "state"):
        known = "positions alone" if source.positions_only else f"data.measured={measured}"
        message = (
            "data.noise: expected the standard deviations of the recorded measurements, beside "
            "sensor=recorded, and for positions a known kinetic energy such as hamiltonian=mechanical; "
            f"received {known}, data.noise={noise}"
        )
        raise UserError(message)
    kind = measured or ("position" if source.positions_only else "state")
    options = {"measured": kind, "noise": noise, "stride": stride}
    check_arguments("data", Recorded, options, ("space", "every", "gaps", "outliers", "seed"))
    return Recorded(source.space, **options)


def build_model(cfg: DictConfig, data: WindowDataModule) -> AbstractModel:
    """Build the model, with the factories of its optimiser, and what checkpoints say of it."""
    from ahnn.models import Optimisation
    from ahnn.training.identifiability import require_identifiable, require_unbiased

    space = data.source.space
    given = {"dof": space.dof, "inertia": space.inertia, "window": cfg.window}
    model = build(cfg.model, "model", controls=len(space.controls), **given).to(data.dtype)
    data.clock = model.dynamics.clock
    if (method := getattr(model.dynamics, "integrator", None)) and data.source.truth is not None:
        method.require(data.source.truth)  # the floor goes through the integrator of the model
    if data.sensor is not None:
        require_identifiable(model.dynamics, data.sensor, windows=model.curriculum.span is not None)
        require_unbiased(cfg.loss.get("balance", 0.0))
    if model.curriculum.span is not None:
        data.require_span(model.curriculum.span)
    else:
        data.follow(model.curriculum, cfg.trainer.max_epochs)
    scheduler = build(cfg.scheduler, "scheduler") if cfg.scheduler else None
    model.optimisation = Optimisation(build(cfg.optimizer, "optimizer"), scheduler)
    known = {"recipe": data.source.recipe(), "split": list(data.splits.fractions)}
    model.about = {"format": FORMAT, "space": about_space(space), "data": known, "settings": settings_of(cfg)}
    return model


DECISIVE = ("max_epochs", "gradient_clip_val", "gradient_clip_algorithm", "accumulate_grad_batches")
"""What of the trainer changes the weights."""
CHOOSING = ("callbacks.best.monitor", "callbacks.rollout.count", "callbacks.rollout.every")
"""What chooses the best of them."""


def settings_of(cfg: DictConfig) -> dict[str, Any]:
    """Return all that determines a training besides its data: what a resumed one must share."""
    parts = {name: plain_config(cfg[name]) for name in ("model", "loss", "optimizer", "scheduler", "data")}
    parts["data"] = {key: value for key, value in parts["data"].items() if key not in SIMULATION}
    parts |= {key: OmegaConf.select(cfg, key) for key in (*CHOOSING, "window", "seed")}
    return {**parts, "trainer": {key: cfg.trainer.get(key) for key in DECISIVE}}


def build_plugins(cfg: DictConfig, splits: SplitData) -> dict[str, EvaluationPlugin]:
    """Build the evaluations that run after fit, and let each refuse data that it does not fit."""
    from ahnn.evaluation import EvaluationPlugin

    plugins = build_all(cfg.plugins, "plugins", EvaluationPlugin)
    source = splits.source
    for name, plugin in plugins.items():
        try:
            plugin.check(source.truth, source.space, source.steps())
        except UserError as error:
            message = f"plugins.{name}: {error}"
            raise UserError(message) from error
    return plugins


def report_options(cfg: DictConfig) -> dict[str, Any]:
    """Return what the user asks of the report."""
    asked = cfg.evaluation
    detail = asked.get("detail", False)  # runs of earlier versions do not have it
    return {"predictions": asked.save_predictions, "figures": asked.figures, "detail": detail}


def robust_of(run: Run) -> RobustName:
    """Return the loss of single residuals that a training took, of which its weights tell.

    Raises:
        UserError: there is no such loss.
    """
    name = flatten(run.about).get("settings.loss.robust", "none")
    if name not in [*ROBUST]:
        message = f"loss.robust: expected one of {', '.join(ROBUST)}; received {name!r}"
        raise UserError(message)
    return name


def build_trainer(cfg: DictConfig) -> Trainer:
    """Build the Lightning trainer with its callbacks and loggers.

    Raises:
        UserError: several devices inside the process of a sweep, which the first job would not give back.
    """
    from lightning import Callback, Trainer
    from lightning.pytorch.loggers import Logger

    from ahnn.training.checkpoint_io import AtomicCheckpointIO

    callbacks = list(build_all(cfg.callbacks, "callbacks", Callback).values())
    logger = list(build_all(cfg.logger, "logger", Logger).values())
    parts = {"callbacks": callbacks, "logger": logger, "default_root_dir": cfg.folder}
    own = cfg.trainer.copy()
    if cfg.loss.get("stages") and own.accelerator == "auto":
        own.accelerator = "cpu"  # where measurements are learned from
    trainer = build(own, "trainer", Trainer, plugins=[AtomicCheckpointIO()], **parts)
    environment = getattr(trainer.strategy, "cluster_environment", None)
    own = environment is not None and environment.creates_processes_externally
    if trainer.world_size > 1 and is_multirun() and not own:
        message = (
            "trainer: expected one device, or a process for each job of the sweep; received "
            f"{trainer.world_size} devices inside the process of the sweep. Add hydra/launcher=ahnn_process"
        )
        raise UserError(message)
    return trainer


def check_together(trainer: Trainer, model: AbstractModel, data: WindowDataModule) -> None:
    """Let model and callbacks refuse, by a method `check`, what they cannot work with; raises UserError."""
    for part in (model, *trainer.callbacks):  # pyright: ignore[reportAttributeAccessIssue]
        if check := getattr(part, "check", None):
            check(trainer)
    if not model.stepper.automatic:
        require_equations(model, data)


def require_equations(model: AbstractModel, data: WindowDataModule) -> None:
    """Refuse second-order steps whose equations do not fit into memory; raises UserError."""
    from ahnn.training.normal_equations import memory_of, memory_of_parts
    from ahnn.training.objectives import PARTS

    count = sum(p.numel() for p in model.dynamics.parameters())
    if data.stages is None:
        windows = min(data.batch_size, data.windows_per_epoch or data.batch_size)
        size = memory_of(count, 2 * model.dof * max(1, windows // PARTS))
    else:
        size = memory_of_parts(count)
    who = "model.network" if size < 2 * memory_of(count, 0) or data.stages else "data.batch_size"
    remedy = "Choose a smaller network or batch" + ("" if data.stages else ", or recipe=first_order")
    require_memory(who, f"the equations of second-order steps on {count:,} parameters", size, remedy)


def is_multirun() -> bool:
    """Return whether this job is one of several."""
    return HydraConfig.initialized() and HydraConfig.get().mode is RunMode.MULTIRUN
