"""Shared libraries built from C source, compiled once per machine and cached."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import logging
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
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.nn import Parameter

from ahnn.contents import read_whole
from ahnn.files import write_cached
from ahnn.paths import cache_dir
from ahnn.types import TimeStep

logger = logging.getLogger(__name__)
# No errno and no traps, so that square roots vectorise; infinities and NaN keep their meaning.
FLAGS = ("-O3", "-funroll-loops", "-fPIC", "-shared", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi")
POINTER, NUMBER, REAL = ctypes.c_void_p, ctypes.c_long, ctypes.c_double
VECTORS = {"AVX512": ("-march=x86-64-v4",), "AVX2": ("-march=x86-64-v3",)}
"""Compiler flags for each vector capability that torch reports."""
PATIENCE = 60.0
"""Time limit of the compiler in seconds; our sources take one or two."""
LARGEST = 50_000_000
"""Size limit of a library in bytes; ours have about ten thousand."""
PART = 2048
"""Number of states that justifies one more core."""


class CompiledFlow(NamedTuple):
    """Flow of time-independent dynamics as a C function, for loops in C.

    Its type is `long (const void *about, long count, const double *x, double dt, double *out)`: it writes the
    states (count, D) after a step dt from x to `out`, bit-identical to the flow in Python, and returns 0.

    Attributes:
        function: address of the function.
        about: address of its constants.
        owners: objects that own the memory of both.
    """

    function: int
    about: int
    owners: tuple[Any, ...]


def compiled_library(
    source: Path,
    signatures: dict[str, tuple[Any, ...]],
    whose: str,
    *,
    vectors: bool = False,
    defined: Sequence[str] = (),
) -> ctypes.CDLL | None:
    """Return the library of a source, or None without a working C compiler.

    The compiler is `$CC`, or else `cc`. The library is kept in the user's cache, in a folder writable only by
    its owner, and its checksum is verified. A compiler that fails or hangs causes one warning.

    Args:
        source: path of the C file.
        signatures: argument types of its functions, which return numbers.
        whose: description of the computation that falls back to slower code, for the warning.
        vectors: whether to compile for the vector extensions that torch reports; old compilers may lack them.
        defined: preprocessor macros required by the source.
    """
    compiler = os.environ.get("CC", "")
    try:
        command = shlex.split(compiler) or ["cc"]
        if shutil.which(command[0]) is None:
            _tell_of_no_compiler(command[0])
            return None
        flags = VECTORS.get(torch.backends.cpu.get_cpu_capability(), ()) if vectors else ()
        found = _built(source, [*command, *FLAGS, *flags, *(f"-D{name}" for name in defined)])
        for name, arguments in signatures.items():
            function = getattr(found, name)
            function.argtypes, function.restype = arguments, NUMBER
    except (OSError, ValueError, AttributeError, subprocess.SubprocessError) as error:
        said = getattr(error, "stderr", None) or error
        message = (
            f"ahnn: {whose} continues without its C library, more slowly; {compiler or 'cc'} said: {said}"
        )
        warnings.warn(message, stacklevel=3)
        return None
    return found


@functools.cache
def _tell_of_no_compiler(program: str) -> None:
    logger.warning(
        "no C compiler: expected a program %s; received none. Small networks, gravity, springs, the "
        "unscented filter and long outputs are computed without their C libraries, more slowly",
        program,
    )


def _built(source: Path, command: list[str]) -> ctypes.CDLL:
    """Return the cached library, or compile one and cache it if the cache folder is private.

    Raises:
        OSError: the library cannot be loaded, or was built for another machine.
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
            with contextlib.suppress(OSError):  # e.g. a full disk: the library serves this process only
                write_cached(path, content + _seal(content, key))
        return ctypes.CDLL(str(made))


def _compile(line: list[str]) -> None:
    """Run a compiler; on time-out kill it with its child processes. Raises the same errors as `_built`."""
    quiet: Any = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    with subprocess.Popen(line, text=True, errors="replace", start_new_session=True, **quiet) as process:
        try:
            _, said = process.communicate(timeout=PATIENCE)
        except BaseException:  # also on an interrupt
            if hasattr(os, "killpg"):  # not on Windows
                os.killpg(process.pid, signal.SIGKILL)
            process.kill()
            raise
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, line, stderr=said[:1000])


def _seal(content: bytes, key: bytes) -> bytes:
    """Return the checksum of a library and its source; it is appended, where loaders ignore it."""
    return hashlib.sha256(key + content).digest()


def _is_intact(path: Path, key: bytes) -> bool:
    """Return whether a file contains the intact library of a source."""
    try:
        whole = read_whole(path, LARGEST)
    except OSError:
        return False
    size = len(whole) - hashlib.sha256().digest_size
    return size > 0 and whole[size:] == _seal(whole[:size], key)


def _own(folder: Path) -> bool:
    """Create the library folder, whose files are executed; return whether only this user can write to it."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        about = folder.stat()
    except OSError:
        return False
    return hasattr(os, "getuid") and about.st_uid == os.getuid() and not about.st_mode & 0o022


def followed() -> bool:
    """Return whether torch traces operations: by a function transform, graph capture or dispatch mode."""
    return (
        torch.compiler.is_compiling()
        or torch._C._are_functorch_transforms_active()
        or torch._C._len_torch_dispatch_stack() > 0
        or torch._C._get_tracing_state() is not None
        or forward_ad._current_level >= 0
    )


def plain(t: Tensor, dtype: torch.dtype) -> bool:
    """Return whether a tensor is plain memory: a CPU tensor of the given type, not a subclass."""
    own = (type(t) is Tensor or type(t) is Parameter) and t.layout == torch.strided
    own = own and torch._C._has_storage(t) and not t.is_neg() and not t._is_zerotensor()
    return own and t.dtype == dtype and t.device.type == "cpu"


def numbers_alone(x: Tensor, dt: TimeStep) -> bool:
    """Return whether float64 CPU states (B, D) need only values, not derivatives."""
    if followed():
        return False
    steps = (dt,) if isinstance(dt, Tensor) else ()
    graph = torch.is_grad_enabled() and any(t.requires_grad for t in (x, *steps))
    known = all(plain(t, torch.float64) for t in (x, *steps))
    fits = x.ndim == 2 and all(t.ndim == 0 or t.shape == x.shape[:1] for t in steps)
    return known and fits and not graph
