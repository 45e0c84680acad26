"""Manifest of the files written by this program, which replaces no other files and follows no links.

Each output folder has a manifest with one line per written file: the SHA-256 of its content and its name, as
`sha256sum` prints them. A file is ours as long as its content matches a digest recorded under its name. The
line is written before the file, so that no crash leaves a file of ours unrecorded.
"""

from __future__ import annotations

import hashlib
import os
import re
import stat
from collections.abc import Iterable
from pathlib import Path

from ahnn.errors import UserError

NAME = ".ahnn-files"
HEAD = (
    "# SHA-256 of each file that ahnn wrote here. It replaces or removes only these, while they are "
    "unchanged.\n"
)
UNRECORDED = {".hydra", "console.log", ".turn", ".claim"}
"""Files that a sweep creates in the folder of a job before the job begins."""
FLAGS = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
"""Flags, where they exist, to follow no link and, on Windows, to leave line feeds unchanged."""
LINE = re.compile(r"([0-9a-f]{64})  (.+)")


def digest_of(content: bytes) -> str:
    """Return the SHA-256 of bytes, in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def recorded(folder: Path) -> dict[str, set[str]]:
    """Return the recorded digests of each file name in a folder; empty without a manifest.

    Raises:
        UserError: the file of that name is not a manifest.
    """
    try:
        text = _text(folder / NAME)
    except FileNotFoundError:
        return {}
    known: dict[str, set[str]] = {}
    for found in map(LINE.fullmatch, text.splitlines()):
        if found:
            known.setdefault(found[2], set()).add(found[1])
    return known


def record(path: Path, digest: str) -> None:
    """Add a line for a file that is about to be written to an existing folder.

    Raises:
        UserError: a file with the manifest's name is not a manifest.
    """
    manifest = path.with_name(NAME)
    try:
        text = _text(manifest)
    except FileNotFoundError:
        text = ""
    line = f"{digest}  {_word(path)}\n"
    if f"\n{line}" in text:
        return
    start = "" if text.endswith("\n") else "\n" if text else HEAD  # a crash may have truncated the last line
    descriptor = os.open(manifest, os.O_WRONLY | os.O_CREAT | os.O_APPEND | FLAGS, 0o666)
    with open(descriptor, "ab", buffering=0) as file:
        file.write(f"{start}{line}".encode())


def is_own(path: Path) -> bool:
    """Return whether a file exists, is not a link, and matches a digest recorded under its name."""
    if path.is_symlink() or not path.is_file():
        return False
    known = recorded(path.parent).get(_word(path), ())
    return bool(known) and digest_of(path.read_bytes()) in known


def require_own(paths: Iterable[Path], who: str) -> None:
    """Refuse to overwrite files that we did not write; called before any work begins.

    Args:
        paths: paths of the files to be written; new paths are always accepted.
        who: configuration key or command, for messages.

    Raises:
        UserError: a path is a foreign file, a file changed since it was written, or a link.
    """
    for path in paths:
        if os.path.lexists(path) and not is_own(path):
            what = "a link" if path.is_symlink() else "a folder" if path.is_dir() else "a file"
            message = (
                f"{who}: expected a new file, or an unchanged one written by ahnn; received {path}, "
                f"{what} that is neither. Move it, or choose another place"
            )
            raise UserError(message)


def remove_own(path: Path) -> None:
    """Remove a file if we wrote it, and the manifest with its last file; leave all other files unchanged."""
    if is_own(path):
        path.unlink(missing_ok=True)
        if not any(path.with_name(name).exists() for name in recorded(path.parent)):
            path.with_name(NAME).unlink(missing_ok=True)


def require_folder(folder: Path, who: str, files: Iterable[Path] = (), inner: Iterable[str] = ()) -> None:
    """Refuse to write a set of results into a folder unless it is new, empty, or ours.

    Args:
        folder: output folder, empty or with earlier results and their manifest.
        who: configuration key or command, for messages.
        files: names of files in it to be replaced or removed.
        inner: names of its subfolders to be written into.

    Raises:
        UserError: the folder, or one of the files and folders in it, is foreign.
    """
    if folder.exists() and not folder.is_dir():
        message = f"{who} {folder}: expected a folder; received a file. Name another"
        raise UserError(message)
    inside = {path.name for path in folder.iterdir()} - UNRECORDED if folder.is_dir() else set()
    if inside and not recorded(folder):
        message = (
            f"{who} {folder}: expected a new or empty folder, or one with earlier results; received one with "
            f"{min(inside)}, which ahnn did not write. Name another"
        )
        raise UserError(message)
    for name in inner:
        require_plain(folder / name)
    require_own(files, who)


def require_plain(folder: Path) -> None:
    """Raise UserError for a link or a file where we need a folder of that name."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        what = "link" if folder.is_symlink() else "file"
        message = f"folder {folder}: expected a folder; received a {what} that ahnn did not write. Move it"
        raise UserError(message)


def own_folder(folder: Path) -> Path:
    """Create and return a folder of ours, such as `figures`; raises the same errors as `require_plain`."""
    require_plain(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _word(path: Path) -> str:
    return path.name.replace("\n", "\\n")


def _text(manifest: Path) -> str:
    plain = stat.S_ISREG(manifest.lstat().st_mode)  # one look, since others may create it meanwhile
    text = manifest.read_text("utf-8", "replace") if plain else ""
    begun = plain and not text  # by another thread or process, which has not yet written its first line
    if not (begun or text.startswith(HEAD[:20])):
        message = f"{manifest}: expected the files that ahnn wrote there; received something else. Move it"
        raise UserError(message)
    return text
