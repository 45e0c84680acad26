"""Compiled libraries in the cache: whole and of their source, or built anew; never other numbers."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import time
import warnings
from pathlib import Path

import pytest

from ahnn import compiled_libraries
from ahnn.compiled_libraries import NUMBER, REAL, compiled_library

SOURCE = "double trusted = 0.4;\nlong answer(double x) { return x == 1.0 ? 42 : 7; }\n"
SIGNATURES = {"answer": (REAL,)}

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")


@pytest.fixture
def built(tmp_path, monkeypatch):
    """Return a function that gives the library of `SOURCE` as a new process would."""
    source = tmp_path / "source.c"
    source.write_text(SOURCE)
    monkeypatch.setenv("AHNN_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("CC", raising=False)
    return lambda: compiled_library(source, SIGNATURES, "the test")


@pytest.fixture
def loaded(monkeypatch):
    """Contents of libraries in the order in which they are loaded; none of them is."""
    contents = []

    class Loaded:
        def __init__(self, path):
            with open(path, "rb") as file:
                contents.append(file.read())
            self.answer = ctypes.CFUNCTYPE(NUMBER, REAL)()

    monkeypatch.setattr(ctypes, "CDLL", Loaded)
    return contents


def kept(tmp_path):
    (path,) = (tmp_path / "cache" / "libraries").glob("*.so")
    return path


def test_a_library_is_compiled_once(built, tmp_path, monkeypatch):
    assert built().answer(1.0) == 42
    content = kept(tmp_path).read_bytes()
    monkeypatch.setattr(compiled_libraries, "_compile", pytest.fail)
    assert built().answer(1.0) == 42
    assert kept(tmp_path).read_bytes() == content


def test_no_flipped_bit_is_ever_loaded(built, tmp_path, loaded, monkeypatch):
    built()
    (sound,) = loaded
    path = kept(tmp_path)
    content = path.read_bytes()
    monkeypatch.setattr(
        compiled_libraries, "_compile", lambda line: Path(line[line.index("-o") + 1]).write_bytes(sound)
    )
    places = [*range(0, len(content), len(content) // 150), *range(len(content) - 32, len(content))]
    for place in places:  # of the library, and of its checksum
        path.write_bytes(content[:place] + bytes([content[place] ^ 1 << place % 8]) + content[place + 1 :])
        built()
        assert path.read_bytes() == content
    assert {*loaded} == {sound}
    assert len(loaded) == 1 + len(places)


def test_nor_is_one_that_is_cut_or_of_another_source(built, tmp_path):
    built()
    path = kept(tmp_path)
    content = path.read_bytes()
    (tmp_path / "source.c").write_text(SOURCE.replace("42", "43"))
    assert built().answer(1.0) == 43
    (other,) = {*(tmp_path / "cache" / "libraries").glob("*.so")} - {path}
    for damaged in (b"", content[:31], content[: len(content) // 2], content[:-1], content + b"x", content):
        other.write_bytes(damaged)
        assert built().answer(1.0) == 43


COMPILERS = {
    "an open quote": ('cc "', "No closing quotation"),
    "a failure": ("false", ""),
    "nothing made": ("true", "No such file"),
    "no library": ("cc -c", ""),
    "no symbols": ("cc -Danswer=question", "answer"),
    "a text": ("sh -c 'while [ $1 != -o ]; do shift; done; echo hello > $2' x", ""),
}


@pytest.mark.parametrize("case", COMPILERS)
def test_a_compiler_that_makes_none_is_one_warning(built, monkeypatch, case):
    command, said = COMPILERS[case]
    monkeypatch.setenv("CC", command)
    for _ in range(2):  # nor does what it left
        with pytest.warns(
            UserWarning, match=f"the test continues without its C library, more slowly.*{said}"
        ):
            assert built() is None


def test_a_missing_compiler_is_no_word(built, monkeypatch):
    for command in ("/nowhere/cc", "nowhere-cc -O3", "/"):
        monkeypatch.setenv("CC", command)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert built() is None


def test_a_compiler_that_hangs_is_ended_with_what_it_started(built, tmp_path, monkeypatch):
    monkeypatch.setattr(compiled_libraries, "PATIENCE", 0.5)
    monkeypatch.setenv("CC", f"sh -c 'sleep 98765 & echo $! > {tmp_path}/child; wait'")
    began = time.monotonic()
    with pytest.warns(UserWarning, match="more slowly"):
        assert built() is None
    assert time.monotonic() - began < 30
    child = (tmp_path / "child").read_text().strip()
    gone = subprocess.run(
        ["ps", "-o", "stat=", "-p", child], capture_output=True, text=True, check=False
    ).stdout
    assert not gone.strip() or gone.startswith("Z")


def test_a_home_that_is_none_is_no_error(built, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("AHNN_CACHE", "~nobody-of-this-name/x")
    assert built().answer(1.0) == 42
