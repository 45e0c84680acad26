"""Stored trajectories are whole, verified, and keyed by everything that determines them."""

from __future__ import annotations

import dataclasses
import importlib
import logging
import os
import subprocess
import sys
import threading

import pytest
import torch
from helpers import SYSTEMS

from ahnn.data import store
from ahnn.data.generate import generate
from ahnn.errors import UserError
from ahnn.files import write_cached
from ahnn.types import Trajectories

SPRING = dataclasses.replace(SYSTEMS["mass_spring"], steps=5)
RECIPE = store.recipe(SPRING, 3, 0)


def make():
    return [generate(SPRING, 3, 0)]


def stored(folder):
    (path,) = folder.glob("*.safetensors")
    return path


def never():
    pytest.fail("generated although stored")


def test_what_is_stored_is_what_was_made(tmp_path):
    (made,) = make()
    store.load_or_make(tmp_path, RECIPE, make)
    loaded = store.load_or_make(tmp_path, RECIPE, never)
    assert torch.equal(made.states, loaded.states)
    assert torch.equal(made.times, loaded.times)
    assert sorted(p.name for p in tmp_path.iterdir()) == [".lock", stored(tmp_path).name]


def test_nan_beyond_the_end_survives_storage(tmp_path):
    states = torch.tensor([[[1.0, 2.0], [torch.nan, torch.nan]]], dtype=torch.float64)
    made = Trajectories(states, torch.tensor([[0.0, 0.1]], dtype=torch.float64))
    store.write(tmp_path / "x.safetensors", [made], RECIPE)
    assert torch.equal(store.read(tmp_path / "x.safetensors").states.isnan(), states.isnan())


def test_data_begin_at_a_multiple_of_eight_bytes_for_any_recipe_and_any_count():
    """As safetensors ask; a header that is written again when the count is known has the same length."""
    for length in range(17):
        short, long = (store.header({"a": "x" * length}, "0" * 64, [n, 9, 2], [1, 9]) for n in (1, 10**9))
        assert len(short) == len(long)
        assert len(short) % 8 == 0


@pytest.mark.parametrize("place", [5, 300, -3])
def test_a_flipped_byte_is_found_and_the_data_are_made_again(tmp_path, caplog, place):
    made = store.load_or_make(tmp_path, RECIPE, make)
    path = stored(tmp_path)
    content = bytearray(path.read_bytes())
    content[place] ^= 0xFF
    path.write_bytes(content)
    with caplog.at_level(logging.WARNING):
        again = store.load_or_make(tmp_path, RECIPE, make)
    assert "damaged" in caplog.text
    assert str(path) in caplog.text
    assert torch.equal(again.states, made.states)
    assert torch.equal(store.load_or_make(tmp_path, RECIPE, never).states, made.states)


def test_a_flipped_byte_in_the_times_is_found(tmp_path):
    (made,) = make()
    store.load_or_make(tmp_path, RECIPE, make)
    path = stored(tmp_path)
    content, last = path.read_bytes(), made.times[0, -1:].numpy().tobytes()
    assert content.count(last) == 1
    path.write_bytes(content.replace(last, torch.tensor([0.06], dtype=torch.float64).numpy().tobytes()))
    assert torch.equal(store.load_or_make(tmp_path, RECIPE, make).times, made.times)


def test_times_of_their_own_survive_storage(tmp_path):
    times = torch.tensor([[0.0, 0.1, 0.3], [0.0, 0.2, 0.3]], dtype=torch.float64)
    made = Trajectories(torch.ones(2, 3, 2, dtype=torch.float64), times)
    store.write(tmp_path / "x.safetensors", [made], RECIPE)
    assert torch.equal(store.read(tmp_path / "x.safetensors").times, times)


def test_one_row_of_times_for_more_trajectories_than_fit_into_memory_is_not_compared():
    times = torch.linspace(0.0, 1.0, 2**8, dtype=torch.float64).expand(2**48, -1)
    assert torch.equal(store.shared_times(Trajectories(times, times)), times[:1])


@pytest.mark.parametrize("size", [0, 4, 200])
def test_a_truncated_file_is_made_again(tmp_path, size):
    store.load_or_make(tmp_path, RECIPE, make)
    path = stored(tmp_path)
    path.write_bytes(path.read_bytes()[:size])
    assert store.load_or_make(tmp_path, RECIPE, make).states.shape == (3, 6, 2)


def test_a_folder_that_cannot_be_written_is_refused_before_generation(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"file/sub: expected a writable place"):
        store.load_or_make(tmp_path / "file" / "sub", RECIPE, never)


def test_a_failed_write_leaves_the_old_file_and_no_litter(tmp_path, monkeypatch):
    path = tmp_path / "x"
    write_cached(path, b"old")

    def fail(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="No space left"):
        write_cached(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_readers_see_whole_files_while_others_write(tmp_path):
    path = tmp_path / "x"
    contents = [bytes([i]) * 200_000 for i in range(4)]
    write_cached(path, contents[0])
    writers = [threading.Thread(target=write_cached, args=(path, c)) for c in contents]
    for writer in writers:
        writer.start()
    seen = {path.read_bytes() for _ in range(50)}
    for writer in writers:
        writer.join()
    assert seen <= set(contents)


KILLED = """
import os, signal, sys
from pathlib import Path
from ahnn.files import write_cached
os.fsync = lambda _: os.kill(os.getpid(), signal.SIGKILL)
write_cached(Path(sys.argv[1]), b"new")
"""


def test_what_a_killed_writer_left_goes_with_the_next_write_in_the_folder(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED, tmp_path / "x"], check=False)
    foreign = tmp_path / ".mine.tmp"
    foreign.write_bytes(b"dear")
    assert len(list(tmp_path.glob(".x.*.tmp"))) == 1
    write_cached(tmp_path / "z", b"new")
    assert {path.name for path in tmp_path.iterdir()} == {".mine.tmp", "z"}


def test_no_writer_loses_its_file_to_the_others(tmp_path):
    failures = []

    def write(number):
        try:
            for _ in range(100):
                write_cached(tmp_path / f"{number}", bytes(1000))
        except OSError as error:
            failures.append(error)

    writers = [threading.Thread(target=write, args=(n % 4,)) for n in range(8)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert not failures
    assert {path.name for path in tmp_path.iterdir()} == {"0", "1", "2", "3"}


@pytest.mark.parametrize("name", ["mass_spring", "molniya", "kepler", "pendulum", "henon_heiles"])
def test_every_parameter_of_a_system_changes_the_recipe(name):
    system = SYSTEMS[name]
    recipes = [store.recipe(system, 3, 0), store.recipe(system, 4, 0), store.recipe(system, 3, 1)]
    for field in dataclasses.fields(system):
        value = getattr(system, field.name)
        if isinstance(value, tuple):
            other = (value[0], value[1] + 0.1)
        else:
            other = f"{value}x" if isinstance(value, str) else (value or 1) * 2
        recipes.append(store.recipe(dataclasses.replace(system, **{field.name: other}), 3, 0))
    assert len({str(recipe) for recipe in recipes}) == len(recipes)


def test_systems_of_equal_parameters_do_not_share_a_recipe():
    kepler, pendulum = (store.recipe(SYSTEMS[n], 3, 0) for n in ("kepler", "pendulum"))
    assert kepler["system"] != pendulum["system"]


MINE = """
from dataclasses import dataclass
from ahnn.systems import MassSpring, System, Units
from ahnn.systems.pendulum import Pendulum
def law(q):
    return -q{power}
@dataclass(frozen=True, kw_only=True)
class Mine(System):
    dof, components, integrator, noise = 1, ("q", "p"), "kahan_li8", MassSpring.noise
    units = Units()
    def energy(self, x): return x[..., 0]
    def force(self, q): return law(q)
    def initial_states(self, count, generator): return None
"""


def mine(folder, monkeypatch, name="my_systems", power=""):
    """A system in a module of the user's own."""
    (folder / f"{name}.py").write_text(MINE.replace("{power}", power))
    monkeypatch.syspath_prepend(folder)
    importlib.invalidate_caches()
    sys.modules.pop(name, None)
    return importlib.import_module(name).Mine(name="mine", dt=0.1, steps=3)


def test_an_edited_system_of_ones_own_has_another_recipe(tmp_path, monkeypatch):
    first = store.recipe(mine(tmp_path, monkeypatch), 3, 0)
    again = store.recipe(mine(tmp_path, monkeypatch), 3, 0)
    edited = store.recipe(mine(tmp_path, monkeypatch, power="**3"), 3, 0)
    other = store.recipe(mine(tmp_path, monkeypatch, name="other_systems"), 3, 0)
    assert first == again
    assert first["code"] != edited["code"]
    assert first["system"] != other["system"]
    assert "code" not in RECIPE


def nowhere(text):
    """A class whose source nobody has."""
    functions = {}
    exec(text, functions)
    return type("Mine", (), {"force": functions["force"], "mass": 1.0, "__module__": "nowhere"})


@pytest.mark.parametrize(
    ("text", "edit"),
    [
        ("(self, q): return -q * q", "(self, q): return -q + q"),
        ("(self, q): return -2.0 * q", "(self, q): return -3.0 * q"),
        ("(self, q): return abs(q)", "(self, q): return len(q)"),
        ("(self, q): return (lambda x: x * 2.0)(q)", "(self, q): return (lambda x: x * 3.0)(q)"),
        ("(self, q): return q if q in {1, 2} else 0", "(self, q): return q if q in {1, 3} else 0"),
        ("(self, q, k=2.0): return -k * q", "(self, q, k=3.0): return -k * q"),
        ("(self, q, *, k=2.0): return -k * q", "(self, q, *, k=3.0): return -k * q"),
    ],
)
def test_a_system_without_source_goes_by_its_bytecode_and_the_numbers_in_it(text, edit):
    first, again, edited = (store.source_of(nowhere(f"def force{result}")) for result in (text, text, edit))
    assert set(first) == {"nowhere"}
    assert first == again != edited
