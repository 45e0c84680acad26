"""Evaluations of cases by the filter as its YAML describes it."""

from __future__ import annotations

import copy
from functools import cache
from pathlib import Path

from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from ahnn.cli.build import build_all
from ahnn.cli.commandline import pair
from ahnn.data.generate import generate
from ahnn.evaluation import Case, Findings
from ahnn.integrators import INTEGRATORS
from ahnn.paths import conf_dir
from ahnn.systems import System
from ahnn.types import Flow

drawn = cache(generate)
"""Trajectories that cases of a system share."""


def case_of(system: System, flow: Flow, perturbation: Tensor, folder: Path, validation: int = 6) -> Case:
    """A flow that is judged on as many trajectories of a system as there are initial errors."""
    return Case(
        label="mine",
        assumes="nothing",
        space=system.space,
        truth=system,
        flow=flow,
        energy=None,
        integrator=INTEGRATORS["rk4"],
        dt=system.dt,
        test=drawn(system, len(perturbation), seed=1),
        validation=drawn(system, validation, seed=2),
        train=drawn(system, 4, seed=2),
        perturbation=perturbation,
        folder=folder,
    )


@cache
def composed(group: str, measurement: str) -> DictConfig:
    """The configuration of a command line, composed once: Hydra takes a third of a second for it."""
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        return compose("train", [f"plugins={group}", f"measurement={measurement}", "folder=."])


def run(case: Case, *overrides: str, group: str = "ukf", measurement: str = "position") -> Findings:
    """Evaluate a case by the plugin that the YAML and some overrides describe."""
    cfg = copy.deepcopy(composed(group, measurement))
    name = group if group in cfg.plugins else "ukf"
    for key, value in map(pair, overrides):
        OmegaConf.update(cfg, f"plugins.{name}.{key}", value, force_add=True)
    return build_all(cfg.plugins, "plugins")[name](case)
