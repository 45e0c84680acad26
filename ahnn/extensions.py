"""Registries of named objects, extensible by installed packages through entry points.

Weights files store a registered name, never the path of a class: a foreign file can select only among
installed, declared objects, and cannot cause any other import.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.metadata import entry_points
from typing import TypeVar

T = TypeVar("T")


class Table(Mapping[str, T]):
    """Registry of objects by name; the library's own names take precedence and cannot be replaced.

    Args:
        group: entry point group, with entries `NAME = "package.module:OBJECT"`.
        own: objects of the library.
    """

    def __init__(self, group: str, own: Mapping[str, T]) -> None:
        self.group, self.own = group, own

    def __getitem__(self, name: str) -> T:
        if not isinstance(name, str):  # metadata of a weights file may contain any value
            raise KeyError(name)
        if name in self.own:
            return self.own[name]
        for point in entry_points(group=self.group, name=name):
            return point.load()
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        declared = {point.name for point in entry_points(group=self.group)} - self.own.keys()
        return iter([*self.own, *sorted(declared)])

    def __len__(self) -> int:
        return len(list(iter(self)))
