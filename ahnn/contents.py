"""Safe reading of untrusted files: regular files only, YAML and JSON as plain values."""

from __future__ import annotations

import errno
import json
import os
import re
import stat
from pathlib import Path
from typing import Any

import yaml

from ahnn.errors import UserError

LARGEST = 2_000_000
"""Size limit of a configuration in bytes; ours have a few thousand."""
RESULTS = 200_000_000
"""Size limit of evaluation results in bytes."""
DEEPEST = 20
"""Depth limit of nested values; ours have six levels."""


def require_regular(path: Path) -> None:
    """Reject pipes, sockets and devices, which have no end or block until written to.

    Raises:
        OSError: the path is missing or not a regular file; `strerror` states which.
    """
    try:
        mode = path.stat().st_mode
    except ValueError as error:  # for example a NUL character
        raise OSError(errno.EINVAL, "not the path of a file", str(path)) from error
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "a pipe, socket or device instead of a file", str(path))


def read_whole(path: Path, most: int = LARGEST) -> bytes:
    """Return the bytes of a regular file.

    Args:
        path: path of the file.
        most: maximum size in bytes.

    Raises:
        OSError: the file is unreadable, not regular, or too large; `strerror` states which.
    """
    require_regular(path)
    with path.open("rb") as file:
        # Files in /proc have no size.
        size = min(most, max(os.fstat(file.fileno()).st_size, LARGEST))
        content = file.read(size + 1)
    if len(content) > size:
        raise OSError(errno.EFBIG, f"more than {size:,} bytes", str(path))
    return content


def read_plain(path: Path, expected: str = "the configuration of a run") -> dict[str, Any]:
    """Return the mapping of plain values in a YAML file, which should contain what is `expected`.

    Raises:
        UserError: the file is missing, or is not such a mapping.
    """
    return _keys(path, expected, plain_yaml, LARGEST)


def read_json(path: Path) -> dict[str, Any]:
    """Return the mapping of plain values in a JSON file; raises the same errors as `read_plain`."""
    return _keys(path, "the results of an evaluation", json.loads, RESULTS)


def _keys(path: Path, expected: str, parse: Any, most: int) -> dict[str, Any]:
    try:
        content = parse(read_whole(path, most).decode("utf-8-sig"))
    except OSError as error:
        message = f"{path}: expected {expected}; received: {error.strerror}"
        raise UserError(message) from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        message = f"{path}: expected {expected}; received a damaged file: {' '.join(str(error).split())}"
        raise UserError(message) from error
    if not isinstance(content, dict) or not _is_plain(content):
        kind = "keys that are not strings, or values nested too deeply"
        what = kind if isinstance(content, dict) else repr(content)[:40]
        message = f"{path}: expected {expected}, with plain values for each key; received {what}"
        raise UserError(message)
    return content


def plain_yaml(text: str) -> Any:
    """Return the plain values of an untrusted YAML text; no object is constructed.

    Raises:
        yaml.YAMLError: invalid YAML or value, a duplicate key, an object tag, or an alias, which could expand
            a small file to a huge value.
    """
    try:
        return yaml.load(text, _Plain)
    except ValueError as error:  # for example a date in month 13
        message = f"an invalid value: {error}"
        raise yaml.YAMLError(message) from error


class _Plain(yaml.SafeLoader):
    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            message = "an alias"
            raise yaml.YAMLError(message)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        names = [key.value for key, _ in node.value]
        if again := [name for name in names if names.count(name) > 1]:
            message = f"the key {str(again[0])[:40]!r} twice"
            raise yaml.YAMLError(message)
        return super().construct_mapping(node, deep)


_Plain.add_implicit_resolver(  # YAML 1.1 reads 1e5 as text, JSON and YAML 1.2 read it as a number
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def _is_plain(value: Any, depth: int = 0) -> bool:
    """Return whether values are strings, numbers and booleans in lists and string-keyed dicts."""
    if isinstance(value, dict):
        named = all(isinstance(key, str) for key in value)
        return named and depth < DEEPEST and all(_is_plain(item, depth + 1) for item in value.values())
    if isinstance(value, list):
        return depth < DEEPEST and all(_is_plain(item, depth + 1) for item in value)
    return value is None or isinstance(value, str | bool | int | float)
