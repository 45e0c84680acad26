"""Which files of a folder this program wrote: it replaces and removes no others, and writes through no link.

Each folder that we write into has a manifest, one line for each file that was written: the SHA-256 of its
content and its name, as `sha256sum` prints them. A file counts as ours while its content is still one of
those that were recorded under its name. The line comes before the file, so that no crash leaves a file of
ours without one.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable
from pathlib import Path

from ahnn.errors import UserError

NAME = ".ahnn-files"
HEAD = "# SHA-256 of each file that ahnn wrote here. It replaces and removes these alone, while unchanged.\n"
UNRECORDED = {".hydra", "console.log", ".turn", ".claim"}
"""What a sweep puts into the folder of a job before the job itself begins."""
LINE = re.compile(r"([0-9a-f]{64})  (.+)")


def digest_of(content: bytes) -> str:
    """Return the SHA-256 of a content, in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def recorded(folder: Path) -> dict[str, set[str]]:
    """Return the digests that a folder's manifest has under each name; none without a manifest.

    Raises:
        UserError: a file of that name that is no manifest.
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
    """Add a line for a file that is about to be written; its folder exists.

    Raises:
        UserError: the folder has a file in the place of the manifest that is none.
    """
    manifest = path.with_name(NAME)
    try:
        text = _text(manifest)
    except FileNotFoundError:
        text = ""
    line = f"{digest}  {_word(path)}\n"
    if f"\n{line}" in text:
        return
    start = "" if text.endswith("\n") else "\n" if text else HEAD  # a crash may have cut the last line
    descriptor = os.open(manifest, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o666)
    with open(descriptor, "ab", buffering=0) as file:
        file.write(f"{start}{line}".encode())


def is_own(path: Path) -> bool:
    """Return whether a file is there, no link, with a content that we recorded under its name."""
    if path.is_symlink() or not path.is_file():
        return False
    known = recorded(path.parent).get(_word(path), ())
    return bool(known) and digest_of(path.read_bytes()) in known


def require_own(paths: Iterable[Path], who: str) -> None:
    """Refuse to write where something lies that we did not write; asked before any work begins.

    Args:
        paths: of the files to be written; where nothing is, anything may be written.
        who: the key or door that names them.

    Raises:
        UserError: one of them is somebody else's file, was changed since we wrote it, or is a link.
    """
    for path in paths:
        if os.path.lexists(path) and not is_own(path):
            what = "a link" if path.is_symlink() else "a folder" if path.is_dir() else "a file"
            message = (
                f"{who}: expected a new file, or one that ahnn wrote and nobody changed; received {path}, "
                f"{what} of somebody else. Move it, or name another place"
            )
            raise UserError(message)


def remove_own(path: Path) -> None:
    """Remove a file if we wrote it, and the manifest with the last of its files; leave anything else."""
    if is_own(path):
        path.unlink(missing_ok=True)
        if not any(path.with_name(name).exists() for name in recorded(path.parent)):
            path.with_name(NAME).unlink(missing_ok=True)


def require_folder(folder: Path, who: str, files: Iterable[Path] = (), inner: Iterable[str] = ()) -> None:
    """Refuse to write a set of results into a folder unless it is new, empty, or one of ours.

    Args:
        folder: that holds nothing yet, or earlier results with their manifest.
        who: the key or door that names it.
        files: in the folder, to be replaced or removed.
        inner: names of folders in it that will be written into.

    Raises:
        UserError: the folder, or one of the files and folders in it, is somebody else's.
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
    """Refuse a link or a file in the place of a folder whose name we choose; raises UserError."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        what = "link" if folder.is_symlink() else "file"
        message = f"folder {folder}: expected a folder; received a {what} of somebody else. Move it"
        raise UserError(message)


def own_folder(folder: Path) -> Path:
    """Make a folder whose name we choose, such as `figures`, and return it; raises as `require_plain`."""
    require_plain(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _word(path: Path) -> str:
    return path.name.replace("\n", "\\n")


def _text(manifest: Path) -> str:
    if manifest.is_symlink() or (manifest.exists() and not manifest.is_file()):
        text = ""
    else:
        text = manifest.read_text("utf-8", "replace")
    if not text.startswith(HEAD[:20]):
        message = f"{manifest}: expected the files that ahnn wrote there; received something else. Move it"
        raise UserError(message)
    return text
