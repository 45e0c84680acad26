"""`ahnn` lists the commands; with arguments it says which command was meant."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from entry import untouched

from ahnn.__main__ import COMMANDS, main

ROOT = Path(__file__).parents[1]


def called(*arguments: str) -> int:
    with untouched(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["ahnn", *arguments])
        try:
            main()
        except SystemExit as stopped:
            return int(stopped.code or 0)
    return 0


@pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"], ["--version"]])
def test_the_overview_lists_the_commands(arguments, capsys):
    assert called(*arguments) == 0
    assert "python -m ahnn.train" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["train", "system=pendulum"],
            "Use `ahnn-train system=pendulum` or `python -m ahnn.train system=pendulum`",
        ),
        (["data", "check", "a b.csv"], "Use `python -m ahnn.data check 'a b.csv'`"),
        (["trian"], "received 'trian'. `ahnn` alone lists the commands"),
        (["--hlp"], "received '--hlp'. `ahnn` alone lists the commands"),
    ],
)
def test_arguments_are_refused_with_the_command_that_was_meant(arguments, said, capsys):
    assert called(*arguments) == 2
    shown = capsys.readouterr()
    assert said in shown.err
    assert shown.out == ""


def test_each_listed_command_but_data_is_also_a_script():
    scripts = re.findall(r"^ahnn-(\w+) = ", (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    assert {*re.findall(r"-m ahnn\.(\w+) ", COMMANDS)} == {*scripts, "data"}
