"""What an assimilation is told: options of conf/assimilate.yaml, and what is built from them and the run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from omegaconf import DictConfig, ListConfig, OmegaConf

from ahnn.arguments import Count, Finite, Positive, Within, check_arguments, nearest
from ahnn.assimilation import Assimilation, Process, Sensor
from ahnn.assimilation.start import start_of
from ahnn.cli import commandline
from ahnn.cli.again import GROUPS, KEYS, NODES, OWN, Request
from ahnn.cli.build import blaming, build, build_all, plain_config
from ahnn.cli.parts import build_sensor, build_source
from ahnn.cli.trust import read_plain
from ahnn.data import SplitData
from ahnn.errors import UserError
from ahnn.evaluation import Case, EvaluationPlugin
from ahnn.evaluation.prepare import make_case
from ahnn.measurements import reading
from ahnn.runs import Run
from ahnn.systems import System

FILTER = "plugins=ukf"
"""What filters where a run names no plugin."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """The keys of conf/assimilate.yaml."""

    measurements: str
    output: str
    format: Literal["csv", "json"] | None = None
    state: str | None = None
    every: Count
    start: str | list[float] | None = None
    start_sd: list[Positive] | None = None
    time: Finite
    sensors: dict[str, Any]
    window: Annotated[float, Within(0)]
    lines: Count
    gap: Positive | None = None
    watch: bool
    figures: str | None = None
    oem: str | None = None
    object: str
    epoch: str
    frame: str
    center: str
    time_system: str


def asked(arguments: list[str], usage: str) -> tuple[Options, DictConfig, Request]:
    """Return the options of a command line, the nodes of its sensors, and what it asks of the run.

    Raises:
        UserError: no run or no measurements, an unknown key, or a value of another type.
    """
    given = ["watch=true" if argument == "--watch" else argument for argument in arguments]
    loader = commandline.config_loader()
    own = commandline.compose(loader, "assimilate", [])
    mine = [text for text in given if _key(text) in own]
    known = {*own, *OWN, *GROUPS, *NODES, *KEYS} - {"hydra"}
    if unknown := [key for text in given if "=" in text and (key := _key(text)) not in known]:
        message = f"unknown key {unknown[0]!r}{nearest(unknown[0], sorted(known))}"
        raise UserError(message)
    request = Request.of([text for text in given if text not in mine], usage)
    cfg = commandline.compose(loader, "assimilate", mine)
    OmegaConf.set_struct(cfg, False)
    cfg.pop("hydra", None)
    check_arguments("", Options, plain_config(cfg))
    options = Options(**plain_config(cfg))
    if options.output == "-" and (options.figures or options.oem):
        message = "output: expected a FILE, of which figures and oem are made; received -"
        raise UserError(message)
    plain = read_plain(request.source / "config.yaml").get("plugins")
    if not plain and not any(text.startswith("plugins=") for text in request.overrides):
        request = request._replace(overrides=[FILTER, *request.overrides])
    return options, cfg.sensors, request


def _key(text: str) -> str:
    """Return the top level of a key; of a group that is put under sensors, that."""
    key = text.partition("=")[0].lstrip("+~")
    return (key.partition("@")[2] or key).partition(".")[0]


def build_sensors(
    nodes: DictConfig, cfg: DictConfig, run: Run, truth: Callable[[], System | None]
) -> dict[str, Sensor]:
    """Build the sensors of a stream; the one of the run's group `measurement` where none are named.

    Raises:
        UserError: no model, or standard deviations that do not fit.
    """
    made = {}
    for name, node in (nodes or OmegaConf.create({"": cfg.measurement})).items():
        who, named = f"sensors.{name}" if name else "measurement", node.get("model")
        with blaming(who):
            model = reading(named, run.space) if isinstance(named, str) else build(named, f"{who}.model")
            if (mass := getattr(model, "mass", run.space.inertia)) != run.space.inertia:
                message = f"expected mass={run.space.inertia:g}, that of the run; received mass={mass:g}"
                raise ValueError(message)
            sd: Any = list(node.sd) if isinstance(node.get("sd"), ListConfig) else node.get("sd")
            known = truth() if sd is None and named == "position" else None
            called = str(name) or (named if isinstance(named, str) else type(model).__name__)
            try:
                made[called] = Sensor.of(model, sd if known is None else known.noise.measurement, run.space)
            except UserError as error:
                message = f"{who}.{error}"
                raise UserError(message) from None
    return made


def build_process(cfg: DictConfig, run: Run, case: Callable[[], Case]) -> Process:
    """Build the online process of the one plugin that has one.

    Raises:
        UserError: none has, or several.
    """
    plugins = build_all(cfg.plugins, "plugins", EvaluationPlugin)
    online = {name: plugin for name, plugin in plugins.items() if hasattr(plugin, "online")}
    if len(online) != 1:
        received = ", ".join(plugins) or "none"
        message = f"plugins: expected one that filters online, such as {FILTER}; received {received}"
        raise UserError(message)
    ((name, plugin),) = online.items()
    with blaming(f"plugins.{name}"):
        novelty = None if run.domain is None else run.novelty
        return plugin.online(run.dynamics, run.dt, run.space, case, novelty)


def build_assimilation(options: Options, nodes: DictConfig, cfg: DictConfig, run: Run) -> Assimilation:
    """Build the filter of a stream; data are only made where a process noise is fitted to them.

    Raises:
        UserError: what is built from the options does not fit the run.
    """
    source = cache(lambda: build_source(cfg))
    sensors = build_sensors(nodes, cfg, run, lambda: source().truth)
    deviations = options.start_sd
    if deviations is None and not isinstance(options.start, str) and (truth := source().truth) is not None:
        deviations = truth.deviations().tolist()
    start = start_of(options.start, deviations, run.space)

    def case() -> Case:
        splits = SplitData(source(), list(cfg.data.split), build_sensor(cfg, source()))
        return make_case(run.dynamics, splits, label=cfg.label, seed=cfg.evaluation.seed, folder=run.folder)

    limits = {"window": options.window, "lines": options.lines, "gap": options.gap}
    return Assimilation(build_process(cfg, run, case), sensors, start, time=options.time, **limits)


def kind_of(options: Options) -> Literal["csv", "json"]:
    """Return the format of the output."""
    return options.format or ("json" if Path(options.output).suffix in (".json", ".jsonl") else "csv")
