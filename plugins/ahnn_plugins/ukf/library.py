"""The C library of the square-root form, compiled once for a machine and kept beside other caches."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
import warnings
from functools import cache
from pathlib import Path

from ahnn.files import write_atomically

SOURCE = Path(__file__).with_name("members.c")
# No errno and no traps, so that square roots are vector operations; infinities and NaN stay what they are.
FLAGS = ("-O3", "-funroll-loops", "-fPIC", "-shared", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi")
P, N = ctypes.c_void_p, ctypes.c_long
SIGNATURES = {
    "ahnn_draw": (N, N, P, P, N, P, N, P),
    "ahnn_predict": (N, N, P, P, P, N, P, N, P, P),
    "ahnn_joint": (N, N, N, P, P, N, P, N, P, P, N, P, N, P, P),
    "ahnn_condition": (N, N, N, P, P, P, P, P, P, P, P, P, P),
}
"""Arguments of its functions: addresses and numbers."""


@cache
def library() -> ctypes.CDLL | None:
    """Return the library, or None where there is no C compiler; the filter is slower without it.

    The compiler is `$CC`, or else `cc`. The library is kept in `$AHNN_CACHE`, `~/.cache/ahnn` by default, in
    a folder where only its owner can write. A compiler that fails gives one warning.
    """
    command = shlex.split(os.environ.get("CC", "")) or ["cc"]
    if shutil.which(command[0]) is None:
        return None
    try:
        return _declared(_built(command))
    except (OSError, subprocess.CalledProcessError) as error:
        told = getattr(error, "stderr", None) or error
        message = (
            f"ahnn: the filter goes on without its C library, slower; {shlex.join(command)} said: {told}"
        )
        warnings.warn(message, stacklevel=2)
        return None


def _built(command: list[str]) -> ctypes.CDLL:
    """Return the library of the cache, or a new one, which is kept there if that is a place of one's own."""
    key = "\0".join((SOURCE.read_text(), *command, *FLAGS, platform.machine(), platform.system()))
    root = Path(os.environ.get("AHNN_CACHE") or "~/.cache/ahnn").expanduser()
    path = root / "libraries" / f"members-{hashlib.sha256(key.encode()).hexdigest()[:16]}.so"
    own = _own(path.parent)
    if own and path.is_file():
        with contextlib.suppress(OSError):  # damaged: it is written anew
            return ctypes.CDLL(str(path))
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / path.name
        line = [*command, *FLAGS, "-o", str(made), str(SOURCE), "-lm"]
        subprocess.run(line, check=True, capture_output=True, text=True)
        if own:
            with contextlib.suppress(OSError):  # a full disk, say: it serves this process alone
                write_atomically(path, made.read_bytes())
        return ctypes.CDLL(str(made))


def _own(folder: Path) -> bool:
    """Make a folder for libraries; return whether nobody else can write there: what lies in it is run."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        about = folder.stat()
    except OSError:
        return False
    return about.st_uid == os.getuid() and not about.st_mode & 0o022


def _declared(found: ctypes.CDLL) -> ctypes.CDLL:
    for name, arguments in SIGNATURES.items():
        function = getattr(found, name)
        function.argtypes, function.restype = arguments, N
    return found
