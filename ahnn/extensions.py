"""Names of this library, and those that installed packages add to them by entry points.

What is stored beside weights is a name, never the path of a class: a file from elsewhere chooses among what
is installed and declared, and nothing else of it is imported.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.metadata import entry_points
from typing import TypeVar

T = TypeVar("T")


class Table(Mapping[str, T]):
    """What stands behind each name; the library's own come first, and no package replaces them.

    Args:
        group: of entry points, `NAME = "package.module:OBJECT"`.
        own: of the library.
    """

    def __init__(self, group: str, own: Mapping[str, T]) -> None:
        self.group, self.own = group, own

    def __getitem__(self, name: str) -> T:
        if not isinstance(name, str):  # whatever stands beside weights
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
