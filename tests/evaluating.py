"""Evaluations of cases by the filter as its YAML describes it."""

from __future__ import annotations

import copy
from functools import cache

from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, OmegaConf

from ahnn.cli.build import build_all
from ahnn.cli.commandline import pair
from ahnn.evaluation import Case, Findings
from ahnn.paths import conf_dir


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
