"""Compositions by Hydra that a test session shares: the same options of conf/ are read and merged once."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from hydra._internal import config_loader_impl, defaults_list
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import ConfigRepository, IConfigRepository
from hydra._internal.defaults_list import DefaultsList, Overrides, create_defaults_list
from hydra.core.default_element import InputDefault, ResultDefault
from hydra.plugins.config_source import ConfigResult
from omegaconf import DictConfig

from ahnn.paths import conf_dir

FIXED = {"pkg://hydra.conf", f"file://{conf_dir()}", "structured://"}
"""Places whose files no test changes."""

READ, MERGE = ConfigRepository.load_config, ConfigLoaderImpl._compose_config_from_defaults_list
PLACE = ConfigLoaderImpl._load_single_config
CHOOSE, NAMES = create_defaults_list, defaults_list._create_interpolation_map
"""What Hydra calls to read a file, merge files, put one in its place, choose them and know what it chose."""

Places = tuple[tuple[str, str], ...]


@contextmanager
def shared() -> Iterator[None]:
    """Read the files of conf/ and merge each choice of options once; values and errors stay Hydra's own.

    A search path with other folders is read anew each time. Copies are made by pickle, five times as fast as
    `copy.deepcopy`.
    """
    files: dict[tuple[Places, str], bytes] = {}
    choices: dict[tuple[Any, ...], DefaultsList] = {}
    placed: dict[tuple[Any, ...], bytes] = {}
    merged: dict[int, tuple[list[ResultDefault], bytes]] = {}

    def read_once(self: ConfigRepository, config_path: str) -> ConfigResult | None:
        places = _places(self)
        if places is None:
            return READ(self, config_path)
        if (places, config_path) not in files:
            files[places, config_path] = pickle.dumps(READ(self, config_path))
        return pickle.loads(files[places, config_path])

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
            made = MERGE(self, _begun(self, defaults, repo, placed), repo)
            merged[id(defaults)] = defaults, pickle.dumps(made)  # keeps the list, and so its id
            return made
        return pickle.loads(merged[id(defaults)][1])

    def place_once(self: ConfigLoaderImpl, default: ResultDefault, repo: IConfigRepository) -> ConfigResult:
        places = _places(repo)
        if places is None:
            return PLACE(self, default, repo)
        key = places, default.config_path, default.package, default.primary
        if key not in placed:
            placed[key] = pickle.dumps(PLACE(self, default, repo))
        return pickle.loads(placed[key])

    with _calls(read_once, choose_once, merge_once, place_once, _names_if_asked):
        yield


def _begun(
    self: ConfigLoaderImpl,
    defaults: list[ResultDefault],
    repo: IConfigRepository,
    placed: dict[tuple[Any, ...], bytes],
) -> list[ResultDefault]:
    """Return the defaults with one element for the files of Hydra, which come first and seldom differ."""
    count = 1 + [one.config_path for one in defaults].index("hydra/config")
    first = ResultDefault(package=" ".join(f"{one.config_path}@{one.package}" for one in defaults[:count]))
    key = _places(repo), first.config_path, first.package, first.primary
    if key not in placed:
        found = ConfigResult("shared", "", MERGE(self, defaults[:count], repo), {"package": None})
        placed[key] = pickle.dumps(found)
    return [first, *defaults[count:]]


@contextmanager
def anew() -> Iterator[None]:
    """Let Hydra read and merge everything anew."""
    with _calls(READ, CHOOSE, MERGE, PLACE, NAMES):
        yield


@contextmanager
def _calls(
    read: Callable[..., Any],
    choose: Callable[..., Any],
    merge: Callable[..., Any],
    place: Callable[..., Any],
    names: Callable[..., Any],
) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ConfigRepository, "load_config", read)
        patch.setattr(config_loader_impl, "create_defaults_list", choose)
        patch.setattr(ConfigLoaderImpl, "_compose_config_from_defaults_list", merge)
        patch.setattr(ConfigLoaderImpl, "_load_single_config", place)
        patch.setattr(defaults_list, "_create_interpolation_map", names)
        yield


def _names_if_asked(
    overrides: Overrides, defaults: list[InputDefault], self_added: bool
) -> DictConfig | None:
    """Return the choices that a defaults list may refer to, or None where it refers to none.

    Hydra makes them for every file, which is a third of a composition.
    """
    asked = any(one.is_interpolation() for one in defaults)
    return NAMES(overrides, defaults, self_added) if asked else None


def _places(repo: IConfigRepository) -> Places | None:
    """Return the search path of a repository, or None if files in it may change."""
    places = tuple((source.provider, source.full_path()) for source in repo.get_sources())
    return places if FIXED.issuperset(place for _, place in places) else None
