"""Libraries from C source, compiled once for a machine and kept beside other caches."""

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
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.nn import Parameter

from ahnn.files import write_cached
from ahnn.types import TimeStep

# No errno and no traps, so that square roots are vector operations; infinities and NaN stay what they are.
FLAGS = ("-O3", "-funroll-loops", "-fPIC", "-shared", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi")
POINTER, NUMBER, REAL = ctypes.c_void_p, ctypes.c_long, ctypes.c_double
VECTORS = {"AVX512": ("-march=x86-64-v4",), "AVX2": ("-march=x86-64-v3",)}
"""Flags of the compiler for what torch finds of vectors."""
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

    The compiler is `$CC`, or else `cc`. The library is kept in `$AHNN_CACHE`, `~/.cache/ahnn` by default, in
    a folder where only its owner can write. A compiler that fails gives one warning.

    Args:
        source: a file in C.
        signatures: arguments of its functions, which return numbers.
        whose: what goes on without it, slower.
        vectors: compile for the vectors that torch finds, which an old compiler may not know.
        defined: names that the source asks for.
    """
    command = shlex.split(os.environ.get("CC", "")) or ["cc"]
    if shutil.which(command[0]) is None:
        return None
    flags = VECTORS.get(torch.backends.cpu.get_cpu_capability(), ()) if vectors else ()
    try:
        found = _built(source, [*command, *FLAGS, *flags, *(f"-D{name}" for name in defined)])
    except (OSError, subprocess.CalledProcessError) as error:
        told = getattr(error, "stderr", None) or error
        message = f"ahnn: {whose} goes on without its C library, slower; {shlex.join(command)} said: {told}"
        warnings.warn(message, stacklevel=3)
        return None
    for name, arguments in signatures.items():
        function = getattr(found, name)
        function.argtypes, function.restype = arguments, NUMBER
    return found


def _built(source: Path, command: list[str]) -> ctypes.CDLL:
    """Return the library of the cache, or a new one, which is kept there if that is a place of one's own."""
    texts = (path.read_text() for path in (source, *sorted(source.parent.glob("*.h"))))
    key = "\0".join((*texts, *command, platform.machine(), platform.system()))
    root = Path(os.environ.get("AHNN_CACHE") or "~/.cache/ahnn").expanduser()
    path = root / "libraries" / f"{source.stem}-{hashlib.sha256(key.encode()).hexdigest()[:16]}.so"
    own = _own(path.parent)
    if own and path.is_file():
        with contextlib.suppress(OSError):  # damaged: it is written anew
            return ctypes.CDLL(str(path))
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / path.name
        line = [*command, "-o", str(made), str(source), "-lm"]
        subprocess.run(line, check=True, capture_output=True, text=True)
        if own:
            with contextlib.suppress(OSError):  # a full disk, say: it serves this process alone
                write_cached(path, made.read_bytes())
        return ctypes.CDLL(str(made))


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
