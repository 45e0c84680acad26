"""Libraries from C source, compiled once for a machine and kept beside other caches."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import signal
import subprocess
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.nn import Parameter

from ahnn.contents import read_whole
from ahnn.files import write_cached
from ahnn.paths import cache_dir
from ahnn.types import TimeStep

# No errno and no traps, so that square roots are vector operations; infinities and NaN stay what they are.
FLAGS = ("-O3", "-funroll-loops", "-fPIC", "-shared", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi")
POINTER, NUMBER, REAL = ctypes.c_void_p, ctypes.c_long, ctypes.c_double
VECTORS = {"AVX512": ("-march=x86-64-v4",), "AVX2": ("-march=x86-64-v3",)}
"""Flags of the compiler for what torch finds of vectors."""
PATIENCE = 60.0
"""Seconds that a compiler has; ours take one or two."""
LARGEST = 50_000_000
"""Bytes of a library; ours have some ten thousand."""
PART = 2048
"""States that are worth a core."""


def compiled_library(
    source: Path,
    signatures: dict[str, tuple[Any, ...]],
    whose: str,
    *,
    vectors: bool = False,
    defined: Sequence[str] = (),
) -> ctypes.CDLL | None:
    """Return the library of a source, or None where there is no C compiler.

    The compiler is `$CC`, or else `cc`. The library is kept in the user's cache, in a folder where only its
    owner can write, and verified bit for bit. A compiler that fails or hangs gives one warning.

    Args:
        source: a file in C.
        signatures: arguments of its functions, which return numbers.
        whose: what goes on without it, slower.
        vectors: compile for the vectors that torch finds, which an old compiler may not know.
        defined: names that the source asks for.
    """
    told = os.environ.get("CC", "")
    try:
        command = shlex.split(told) or ["cc"]
        if shutil.which(command[0]) is None:
            return None
        flags = VECTORS.get(torch.backends.cpu.get_cpu_capability(), ()) if vectors else ()
        found = _built(source, [*command, *FLAGS, *flags, *(f"-D{name}" for name in defined)])
        for name, arguments in signatures.items():
            function = getattr(found, name)
            function.argtypes, function.restype = arguments, NUMBER
    except (OSError, ValueError, AttributeError, subprocess.SubprocessError) as error:
        said = getattr(error, "stderr", None) or error
        message = f"ahnn: {whose} goes on without its C library, slower; {told or 'cc'} said: {said}"
        warnings.warn(message, stacklevel=3)
        return None
    return found


def _built(source: Path, command: list[str]) -> ctypes.CDLL:
    """Return the library of the cache, or a new one, which is kept there if that is a place of one's own.

    Raises:
        OSError: there is no library after all, or none of this machine.
        subprocess.SubprocessError: the compiler fails, or takes longer than `PATIENCE`.
    """
    texts = (path.read_text() for path in (source, *sorted(source.parent.glob("*.h"))))
    made_from = "\0".join((*texts, *command, platform.machine(), platform.system()))
    key = hashlib.sha256(made_from.encode()).digest()
    path = cache_dir() / "libraries" / f"{source.stem}-{key.hex()[:16]}.so"
    own = _own(path.parent)
    if own and _is_intact(path, key):
        with contextlib.suppress(OSError):
            return ctypes.CDLL(str(path))
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / path.name
        _compile([*command, "-o", str(made), str(source), "-lm"])
        content = read_whole(made, LARGEST)
        if own:
            with contextlib.suppress(OSError):  # a full disk, say: it serves this process alone
                write_cached(path, content + _seal(content, key))
        return ctypes.CDLL(str(made))


def _compile(line: list[str]) -> None:
    """Run a compiler, and end it with all that it started where it takes too long; raises as `_built`."""
    quiet: Any = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    with subprocess.Popen(line, text=True, errors="replace", start_new_session=True, **quiet) as process:
        try:
            _, said = process.communicate(timeout=PATIENCE)
        except BaseException:  # an interrupt too
            os.killpg(process.pid, signal.SIGKILL)
            raise
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, line, stderr=said[:1000])


def _seal(content: bytes, key: bytes) -> bytes:
    """Return the checksum of a library and its source; it stands behind it, where no loader looks."""
    return hashlib.sha256(key + content).digest()


def _is_intact(path: Path, key: bytes) -> bool:
    """Return whether a file holds the library of a source bit for bit."""
    try:
        whole = read_whole(path, LARGEST)
    except OSError:
        return False
    size = len(whole) - hashlib.sha256().digest_size
    return size > 0 and whole[size:] == _seal(whole[:size], key)


def _own(folder: Path) -> bool:
    """Make a folder for libraries; return whether nobody else can write there: what lies in it is run."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        about = folder.stat()
    except OSError:
        return False
    return about.st_uid == os.getuid() and not about.st_mode & 0o022


def followed() -> bool:
    """Return whether something follows single operations: a transform, a graph in the making, a mode."""
    return (
        torch.compiler.is_compiling()
        or torch._C._are_functorch_transforms_active()
        or torch._C._len_torch_dispatch_stack() > 0
        or torch._C._get_tracing_state() is not None
        or forward_ad._current_level >= 0
    )


def plain(t: Tensor, dtype: torch.dtype) -> bool:
    """Return whether a tensor is what its memory says: numbers of a type on the CPU, and no subclass."""
    own = (type(t) is Tensor or type(t) is Parameter) and t.layout == torch.strided
    own = own and torch._C._has_storage(t) and not t.is_neg() and not t._is_zerotensor()
    return own and t.dtype == dtype and t.device.type == "cpu"


def numbers_alone(x: Tensor, dt: TimeStep) -> bool:
    """Return whether numbers alone are wanted of float64 states (B, D) on the CPU."""
    if followed():
        return False
    steps = (dt,) if isinstance(dt, Tensor) else ()
    graph = torch.is_grad_enabled() and any(t.requires_grad for t in (x, *steps))
    known = all(plain(t, torch.float64) for t in (x, *steps))
    fits = x.ndim == 2 and all(t.ndim == 0 or t.shape == x.shape[:1] for t in steps)
    return known and fits and not graph
