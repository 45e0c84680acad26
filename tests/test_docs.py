"""What the documents print: snippets run, commands exist, and what they say they show is of its shape."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from entry import call, untouched

from ahnn.cli import commandline

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(language):
    """Fenced blocks of a language, with the document and the number of the block."""
    for document in DOCUMENTS:
        for number, (kind, text) in enumerate(FENCE.findall(document.read_text())):
            if kind == language:
                yield pytest.param(text, id=f"{document.name}-{number}")


def commands():
    """Every command of ours that a document prints, without its remark."""
    found = {}
    for document in DOCUMENTS:
        for line in document.read_text().splitlines():
            for text in re.findall(r"python -m ahnn\.\w+[^`\n]*", line):
                found[text.split("  #")[0].split(" # ")[0].strip()] = document.name
    return [pytest.param(text, id=text) for text in sorted(found) if "KEY" not in text]


@pytest.mark.parametrize("text", [*blocks("python")])
def test_a_snippet_runs(text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with untouched():
        exec(compile(text, "snippet", "exec"), {"__name__": "snippet"})


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.name)
def test_an_example_runs(path):
    with untouched():
        exec(compile(path.read_text(), str(path), "exec"), {"__name__": "__main__"})


@pytest.mark.parametrize("text", commands())
def test_a_documented_command_names_what_there_is(text, tmp_path, monkeypatch):
    words = shlex.split(text)
    if words[2] != "ahnn.train" or {"--help", "-sc"} & {*words} or "--config-dir" in words:
        return
    fill = {"W": "5", "SEED": "7", "NAME": "spring", "DIR": str(tmp_path)}
    words = [re.sub(r"=([A-Z]+)$", lambda m: f"={fill.get(m[1], m[1])}", word) for word in words]
    monkeypatch.chdir(tmp_path)
    commandline.check(commandline.read(words[3:]), "train")


def test_the_first_command_prints_what_the_readme_shows(tmp_path, monkeypatch, capsys):
    shown = FENCE.findall((ROOT / "README.md").read_text())
    command, printed = shown[0][1].strip(), shown[1][1]
    monkeypatch.chdir(tmp_path)
    small = ["data.trajectories=40", "data.windows_per_epoch=5000", "trainer.accelerator=cpu"]
    assert call("ahnn.train", *shlex.split(command)[3:], *small) == 0
    lines = capsys.readouterr().out.splitlines()
    wanted = [line for line in printed.splitlines() if not line.startswith("training")]
    assert [shape(line) for line in wanted] == [shape(line) for line in lines[: len(wanted)]]


def shape(line):
    """A line with its numbers made alike, and the blanks that their width leaves."""
    return re.sub(r"\s+", " ", re.sub(r"\d[\d.e+-]*", "0", line)).strip()


@pytest.mark.slow
def test_the_system_of_ones_own_trains(tmp_path):
    texts = dict(FENCE.findall((ROOT / "README.md").read_text())[::-1])
    code = next(t for k, t in FENCE.findall((ROOT / "README.md").read_text()) if "class Quartic" in t)
    (tmp_path / "my_systems.py").write_text(code)
    (tmp_path / "mine" / "system").mkdir(parents=True)
    (tmp_path / "mine" / "system" / "quartic.yaml").write_text(texts["yaml"])
    command = "-m ahnn.train --config-dir mine system=quartic budget=smoke plugins=none run=out"
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    done = subprocess.run(
        [sys.executable, *command.split()], cwd=tmp_path, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "metrics.json").exists()
