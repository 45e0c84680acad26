"""Compositions by Hydra that a test session shares: the same options of conf/ are read and merged once."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from hydra._internal import config_loader_impl
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import ConfigRepository, IConfigRepository
from hydra._internal.defaults_list import DefaultsList, Overrides, create_defaults_list
from hydra.core.default_element import ResultDefault
from hydra.plugins.config_source import ConfigResult
from omegaconf import DictConfig

from ahnn.paths import conf_dir

FIXED = {"pkg://hydra.conf", f"file://{conf_dir()}", "structured://"}
"""Places whose files no test changes."""

READ, MERGE = ConfigRepository.load_config, ConfigLoaderImpl._compose_config_from_defaults_list
CHOOSE = create_defaults_list
"""What Hydra calls to read a file, to merge files, and to choose them."""

Places = tuple[tuple[str, str], ...]


@contextmanager
def shared() -> Iterator[None]:
    """Read the files of conf/ and merge each choice of options once; values and errors stay Hydra's own.

    A search path with other folders is read anew each time.
    """
    files: dict[tuple[Places, str], ConfigResult | None] = {}
    choices: dict[tuple[Any, ...], DefaultsList] = {}
    merged: dict[int, tuple[list[ResultDefault], DictConfig]] = {}

    def read_once(self: ConfigRepository, config_path: str) -> ConfigResult | None:
        places = _places(self)
        if places is None:
            return READ(self, config_path)
        if (places, config_path) not in files:
            files[places, config_path] = READ(self, config_path)
        return copy.deepcopy(files[places, config_path])

    def choose_once(
        repo: IConfigRepository, config_name: str, overrides_list: list[Any], **how: bool
    ) -> DefaultsList:
        places = _places(repo)
        if places is None:
            return CHOOSE(repo, config_name, overrides_list, **how)
        values = Overrides(repo, overrides_list).config_overrides
        groups = [one for one in overrides_list if not any(one is value for value in values)]
        key = places, config_name, *(one.input_line for one in groups), *how.items()
        if key not in choices:
            choices[key] = CHOOSE(repo, config_name, groups, **how)
        found = copy.copy(choices[key])
        found.config_overrides = values
        return found

    def merge_once(
        self: ConfigLoaderImpl, defaults: list[ResultDefault], repo: IConfigRepository
    ) -> DictConfig:
        if _places(repo) is None:
            return MERGE(self, defaults, repo)
        if id(defaults) not in merged:
            merged[id(defaults)] = defaults, MERGE(self, defaults, repo)  # keeps the list, and so its id
        return copy.deepcopy(merged[id(defaults)][1])

    with _calls(read_once, choose_once, merge_once):
        yield


@contextmanager
def anew() -> Iterator[None]:
    """Let Hydra read and merge everything anew."""
    with _calls(READ, CHOOSE, MERGE):
        yield


@contextmanager
def _calls(read: Callable[..., Any], choose: Callable[..., Any], merge: Callable[..., Any]) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ConfigRepository, "load_config", read)
        patch.setattr(config_loader_impl, "create_defaults_list", choose)
        patch.setattr(ConfigLoaderImpl, "_compose_config_from_defaults_list", merge)
        yield


def _places(repo: IConfigRepository) -> Places | None:
    """Return the search path of a repository, or None if files in it may change."""
    places = tuple((source.provider, source.full_path()) for source in repo.get_sources())
    return places if FIXED.issuperset(place for _, place in places) else None
