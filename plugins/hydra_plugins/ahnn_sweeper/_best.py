"""Best trial of a study as a configuration of the group `experiment`."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from ahnn.files import write_atomically

if TYPE_CHECKING:
    import optuna
    from hydra.core.config_loader import ConfigLoader

_NAME = "best.yaml"


def write_best(study: optuna.Study, sweep_dir: Path, config_loader: ConfigLoader, groups: set[str]) -> Path:
    """Write the overrides of the best trial's job as `experiment/best.yaml`, linked as `best.yaml`.

    Hydra finds it with `--config-dir SWEEP_DIR experiment=best`.

    Args:
        study: the study, with at least one complete trial.
        sweep_dir: folder of the sweep.
        config_loader: Hydra's loader.
        groups: the configuration groups of the application.

    Returns:
        The path of the file.
    """
    best = study.best_trial
    text = best_yaml(list(best.user_attrs["overrides"]), config_loader, groups)
    path = sweep_dir / "experiment" / _NAME
    head = f"# Trial {best.number} of study {study.study_name}, value {best.value:.8g}\n"
    write_atomically(path, f"# @package _global_\n{head}{text}".encode())
    link = sweep_dir / _NAME
    if not link.is_symlink():
        with contextlib.suppress(OSError):  # on Windows, only administrators may create links
            link.symlink_to(path.relative_to(sweep_dir))
    return path


def best_yaml(overrides: list[str], config_loader: ConfigLoader, groups: set[str]) -> str:
    """Return a configuration equivalent to the overrides: groups as defaults, the rest as keys."""
    added: list[object] = []
    overridden: list[object] = []
    values = OmegaConf.create({})
    for override in OverridesParser.create(config_loader=config_loader).parse_overrides(overrides):
        key, value = override.key_or_group, override.value()
        if override.is_delete():
            continue
        if key not in groups:
            OmegaConf.update(values, key, value, force_add=True)
        elif key == "experiment":  # this file takes its place
            added.append(value)
        elif override.is_add():
            added.append({f"/{key}": value})
        else:
            overridden.append({f"override /{key}": value})
    defaults = OmegaConf.create({"defaults": [*added, "_self_", *overridden]})
    return OmegaConf.to_yaml(OmegaConf.merge(defaults, values))
