"""Help fits a screen and a half, knows options of one's own, and starts without torch; commands complete."""

from __future__ import annotations

import os
import pydoc
import re
import subprocess
import sys

import pytest
from entry import call

import ahnn

QUARTIC = "# A quartic oscillator.\n_target_: my_systems.Quartic\nname: quartic # yes\n"


@pytest.fixture
def own(tmp_path):
    """A folder with a system and an experiment of one's own."""
    for group in ("system", "experiment"):
        (tmp_path / group).mkdir()
    (tmp_path / "system" / "quartic.yaml").write_text(QUARTIC)
    head = "# @package _global_\ndefaults:\n  - _self_\n"
    (tmp_path / "experiment" / "mine.yaml").write_text(
        f"{head}  - override /system: pendulum\n  - override /model: hnn\n\nexperiment:\n  label: mine\n"
    )
    return tmp_path


def test_help_fits_and_lists_every_group_and_what_a_plain_command_chooses(capsys):
    assert call("ahnn.train", "--help") == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 75
    assert max(map(len, lines)) <= 80
    text = "\n".join(lines)
    for part in (
        "recipe ",
        "second_order_long]",
        "[derivative_mostly]",
        "[generic]",
        "hamiltonian ",
        "--cfg job",
    ):
        assert part in text


def test_help_of_an_option_is_its_yaml_with_what_it_is_built_on(capsys):
    assert call("ahnn.train", "--help", "system=molniya_wide") == 0
    out = capsys.readouterr().out
    assert "# km^3/s^2" in out
    assert out.index("system/molniya.yaml") < out.index("system/molniya_wide.yaml")
    assert call("ahnn.train", "--help", "system=molnya") == 2
    assert capsys.readouterr().err == "ahnn: system: unknown option 'molnya'; did you mean 'molniya'?\n"


def test_options_of_ones_own_are_listed_shown_offered_and_chosen(own, capsys):
    folder = f"--config-dir={own}"
    assert call("ahnn.train", folder, "--help") == 0
    out = capsys.readouterr().out
    assert " quartic" in out
    assert " mine" in out
    assert call("ahnn.train", folder, "--help", "system=quartic") == 0
    assert "# yes" in capsys.readouterr().out
    assert call("ahnn.train", folder, "system=qartic") == 2
    assert "did you mean 'quartic'?" in capsys.readouterr().err
    assert call("ahnn.train", folder, "experiment=mien") == 2
    assert "did you mean 'mine'?" in capsys.readouterr().err
    assert call("ahnn.train", f"hydra.searchpath=[file://{own}]", "experiment=mien") == 2
    assert "did you mean 'mine'?" in capsys.readouterr().err
    assert call("ahnn.train", folder, "experiment=mine", "system.lenth=2") == 2
    assert "did you mean 'system.length'?" in capsys.readouterr().err


def test_help_starts_without_torch():
    code = (
        "import sys; sys.argv = ['ahnn-train', '--help']\n"
        "from ahnn.train import main\n"
        "try: main()\n"
        "finally: assert not {'torch', 'lightning'} & {*sys.modules}"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def installed():
    """The completion in bash, as the command installs it."""
    install = [sys.executable, "-m", "ahnn.train", "-sc", "install=bash"]
    return subprocess.run(install, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("command", ["ahnn-train", "python -m ahnn.train"])
@pytest.mark.parametrize(
    ("typed", "expected"), [("system=mol", "system=molniya"), ("trainer.max_", "trainer.max_epochs=")]
)
def test_commands_complete_in_bash(installed, command, typed, expected):
    words = [*command.split(), typed]
    script = (
        f"{installed}\nCOMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}\n"
        f"COMP_LINE='{command} {typed}'; _ahnn_train; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    )
    done = subprocess.run(["bash", "-c", script], env=os.environ, capture_output=True, text=True, check=True)
    assert any(line.startswith(expected) for line in done.stdout.split()), done


def test_a_terminal_that_knows_ascii_alone_is_served():
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    command = [sys.executable, "-m", "ahnn.train", "label=²"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "special characters" in done.stderr
    assert "Traceback" not in done.stderr


def test_help_of_the_package_fits_a_terminal_of_eighty_columns():
    (description,) = re.findall(
        r"NAME\n.*?(?=PACKAGE CONTENTS)", pydoc.plain(pydoc.render_doc(ahnn)), re.DOTALL
    )
    assert "ahnn.fit(data, space" in description
    assert max(map(len, description.splitlines())) <= 80
