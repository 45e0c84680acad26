"""What the documents print: snippets run, commands compose and run, output has the shape that is shown."""

from __future__ import annotations

import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import pytest
from entry import call, untouched
from helpers import close, generator

from ahnn.cli import commandline
from ahnn.cli.build import stored
from ahnn.cli.compose import compose_job, with_recorded
from ahnn.cli.help import ABOUT
from ahnn.cli.reevaluation import Request, run_config
from ahnn.cli.reproduction_plan import plan
from ahnn.data.generate import generate
from ahnn.rollouts import rollout
from ahnn.systems.truth import exact_flow

ROOT = Path(__file__).parents[1]
ELSEWHERE = ROOT / "docs" / "extending.md"  # tests/test_extending.py installs its package and runs it
TUTORIAL = ROOT / "docs" / "tutorials" / "own_system_and_model.md"
DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted({*(ROOT / "docs").rglob("*.md")} - {ELSEWHERE}),
]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINE = re.compile(r"^\s*((?:python|make|pip|tensorboard|optuna-dashboard|createdb) [^\n]*)", re.MULTILINE)
INLINE = re.compile(r"`(python -m ahnn\.[^`]*|python (?:benchmarks|tests)/[^`]*)`")
FILL = {
    "W": "5",
    "SEED": "7",
    "NAME": "molniya_mechanical",
    "DIR": "runs/mine",
    "FILE": "mine.csv",
    "GCRF": "GCRF",
}
"""What stands for a word in capitals, in commands that are only composed."""

NOT_RUN = {
    "make ": "sets up an environment over the network; continuous integration runs it",
    "pip ": "installs over the network",
    "createdb ": "needs a database server; tests/plugins/sweeper starts one of its own",
    "postgresql": "needs a database server; tests/plugins/sweeper starts one of its own",
    "submitit_slurm": "needs a Slurm cluster; tests/plugins/sweeper/test_slurm.py starts one of its own",
    "ahnn_ray": "needs the extra `ray`; tests/plugins/sweeper/test_sweeper_ray.py",
    "workers=ray": "needs the extra `ray`; tests/test_assimilate_workers.py",
    "workers=8": "joins the shards of an array that needs a Slurm cluster; tests/test_assimilate_workers.py",
    "tensorboard ": "serves until it is stopped",
    "optuna-dashboard ": "serves until it is stopped",
    "budget=paper": "needs a GPU and hours",
    "sweep=paper": "needs a GPU and days",
    "-m ahnn.train model=ahnn window=5 system=molniya": "ten minutes of training, and the filter",
    "-m ahnn.train system=molniya model=ahnn": "ten minutes of training, and the filter",
    "-m ahnn.reproduce system=mass_spring budget=laptop": "fifteen trainings of 20,000 steps",
    "-m ahnn.reproduce system=molniya budget=laptop": "fifteen trainings of 20,000 steps",
    "runs/reproduce/mass_spring_laptop": "needs the thirty runs of the two commands before it",
    "bench_time_to_accuracy": "twenty minutes: the plain loop is given twelve times as long",
    "sweep=quick trainer=ddp": "forty trials of two processes each, over ten minutes on two cores",
    "benchmarks/run.py": "minutes, and it writes docs/benchmarks.md anew",
    "mutate.py": "hours: the suite runs once for each change",
    "campaign/run.py": "hours: 3,000 cases",
    "bench_gpu.py": "needs a GPU",
    "trainer.accelerator=gpu": "needs a GPU; tests/test_gpu.py runs it where there is one",
    "ahnn.orbit ": "needs real measurements; tests/tracking/test_orbit_door.py runs it where they are",
    "ahnn.benchmark all": "hours: ten trainings for each model of each task",
    "bench_ensemble_bands": "an hour on shared cores: forty trainings",
    "bench_posteriors": "half an hour: twenty-five trainings and their Monte Carlo chains",
    "ahnn.calibrate experiment": "an hour: twenty trainings",
}
"""Commands that the slow suite leaves out, by a part of them, and why."""


class Command(NamedTuple):
    """A command as a document prints it, and the section that it stands in."""

    text: str
    section: str


def sections(document):
    """Yield heading and text of each section of a document; a tutorial is one, step by step."""
    if document.parent.name == "tutorials":
        yield document.name, document.read_text()
        return
    heads = re.split(r"^#+ (.*)$", document.read_text(), flags=re.MULTILINE)
    for number, (title, text) in enumerate(zip(heads[1::2], heads[2::2], strict=True)):
        yield f"{document.name}-{number} {title}", text


def commands():
    """Return every command of the documents in their order, without its remark and its broken lines."""
    found = []
    for document in DOCUMENTS:
        for section, text in sections(document):
            shell = [block for kind, block in FENCE.findall(text) if not kind]
            printed = [line for block in shell for line in LINE.findall(block.replace("\\\n", " "))]
            inline = INLINE.findall(FENCE.sub("", text))
            for command in (*printed, *(" ".join(words.split()) for words in inline)):
                found.append(Command(re.split(r"\s#\s", command)[0].strip(), section))
    return found


def blocks(language):
    """Fenced blocks of a language, with the document and the number of the block."""
    for document in DOCUMENTS:
        for number, (kind, text) in enumerate(FENCE.findall(document.read_text())):
            if kind == language and document.name != "filter.md":  # tests/plugins/ukf/test_ukf_document.py
                yield pytest.param(text, id=f"{document.name}-{number}")


@pytest.mark.slow
@pytest.mark.parametrize("text", [*blocks("python")])
def test_a_snippet_runs(text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    module = ModuleType("snippet")
    monkeypatch.setitem(sys.modules, "snippet", module)  # where dataclasses look for what they stand in
    with untouched():
        exec(compile(text, "snippet", "exec"), vars(module))


def test_the_system_of_the_tutorial_moves_as_its_energy_says(monkeypatch):
    module = ModuleType("snippet")
    monkeypatch.setitem(sys.modules, "snippet", module)
    shown = FENCE.findall(TUTORIAL.read_text())
    exec(next(text for _, text in shown if "class Quartic" in text), vars(module))
    system = module.Quartic(name="quartic", dt=0.01, steps=1000)
    states = rollout(exact_flow(system), system.initial_states(5, generator(0)), 0.01, 101)
    energies = system.energy(states)
    close(energies, energies[:, :1].expand_as(energies), 1e-9)
    assert float((states[:, -1] - states[:, 0]).norm(dim=-1).min()) > 0
    exec(next(text for _, text in shown if "class Damped" in text), vars(module))
    damped = module.Damped(name="damped", dt=0.01, steps=1000)
    lost = damped.energy(rollout(exact_flow(damped), states[:, 0], 0.01, 1001)).diff(dim=1)
    for name in ("LotkaVolterra", "Coupled"):
        exec(next(text for _, text in shown if f"class {name}" in text), vars(module))
        other = getattr(module, name)(name=name, dt=0.01, steps=100)
        energies = other.energy(generate(other, 4, 0).states)  # which compares the energy with the equations
        close(energies, energies[:, :1].expand_as(energies), 1e-9)
        assert not other.mechanical
    assert float(lost.max()) < 1e-12  # -friction v^2 dt, at rest only at the turning points


EXAMPLES = [ROOT / "examples" / name for name in ("load_and_predict.py", "own_data.py")]
"""tests/test_gallery.py runs those with pictures, tests/graphs/test_export.py the exported model."""


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.name)
def test_an_example_runs_and_a_document_shows_it(path):
    with untouched():
        exec(compile(path.read_text(), str(path), "exec"), {"__name__": "__main__"})
    shown = (ROOT / "README.md").read_text() + (ROOT / "docs" / "data.md").read_text()
    for line in path.read_text().split('"""\n')[1].splitlines():
        assert line in shown or line.startswith("print"), line


COMPOSED = sorted({command.text for command in commands()} | {line.strip() for line in LINE.findall(ABOUT)})


@pytest.mark.parametrize("command", COMPOSED)
def test_a_documented_command_names_what_there_is(command, tmp_path, monkeypatch):
    if "submitit" in command:
        pytest.importorskip("submitit", reason="the extra `slurm` is needed")
    monkeypatch.chdir(tmp_path)
    if "swings.csv" in command:
        runpy.run_path(str(ROOT / "docs" / "tutorials" / "make_swings.py"))
    text = re.split(r"\s#\s", command)[0]
    words = [re.sub(r"=([A-Z]+)$", lambda m: f"={FILL.get(m[1], m[1])}", word) for word in shlex.split(text)]
    if words[0] == "make":
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(), re.MULTILINE)
    elif words[1].endswith(".py"):
        assert (ROOT / words[1]).is_file()
    elif words[:3] == ["python", "-m", "ahnn.train"] and "-sc" not in words:
        own = tmp_path / "mine" / "system" / "quartic.yaml"
        own.parent.mkdir(parents=True)
        own.write_text("_target_: my_systems.Quartic\nname: quartic\n")
        if any("experiment=best" in word for word in words):
            words = [word for word in words if word != "experiment=best"]  # that is what a search writes
            (tmp_path / words[words.index("--config-dir") + 1]).mkdir(parents=True)
        commandline.check(commandline.read(with_recorded(words[3:])), "train")
    elif words[:3] == ["python", "-m", "ahnn.evaluate"] and words[3:] != ["--help"]:
        request = Request.of(words[3:])
        cfg = compose_job(["experiment=molniya_central_body", "plugins=ukf"], tmp_path)
        (tmp_path / "config.yaml").write_bytes(stored(cfg))
        run_config(tmp_path, request)
    elif words[:3] == ["python", "-m", "ahnn.reproduce"] and words[3:] != ["--help"]:
        assert plan([*words[3:], "seed=7"]).steps  # one seed says as much as three


SHOWN = {
    "central_body on molniya": ["plugins=none", "experiment=molniya_central_body", "system.steps=300"],
    "ahnn5 on mass_spring": [],
}


@pytest.mark.parametrize(
    "title", ["central_body on molniya", pytest.param("ahnn5 on mass_spring", marks=pytest.mark.slow)]
)
def test_a_command_prints_what_a_document_shows(title, tmp_path, monkeypatch, capsys):
    documents = (ROOT / "README.md").read_text() + (ROOT / "docs" / "floors.md").read_text()
    (printed,) = (text for kind, text in FENCE.findall(documents) if f"\n{title}" in text)
    monkeypatch.chdir(tmp_path)
    small = ["data.trajectories=100", "data.windows_per_epoch=5000", "trainer.accelerator=cpu"]
    assert call("ahnn.train", *SHOWN[title], "trainer.max_epochs=1", *small) == 0
    lines = capsys.readouterr().out.splitlines()
    wanted = [line for line in printed.splitlines() if not line.startswith(("training", "epoch", "results"))]
    assert [shape(line) for line in wanted] == [shape(line) for line in lines[: len(wanted)]]


def shape(line):
    """A line with its numbers made alike, and the blanks that their width leaves."""
    return re.sub(r"\s+", " ", re.sub(r"\d[\d.e+-]*", "0", line)).strip()


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    """A folder for each section: scripts, the tutorial's own system, and the README's first run."""
    made, shown = {}, FENCE.findall(TUTORIAL.read_text())
    system = next(text for _, text in shown if "class Quartic" in text)
    yaml = next(text for kind, text in shown if kind == "yaml")

    def place(section):
        if section not in made:
            folder = made[section] = tmp_path_factory.mktemp("section")
            for name in ("benchmarks", "docs", "examples", "tests"):
                (folder / name).symlink_to(ROOT / name)
            (folder / "my_systems.py").write_text(system)
            (folder / "mine" / "system").mkdir(parents=True)
            (folder / "mine" / "system" / "quartic.yaml").write_text(yaml)
            here = [c.text for c in commands() if c.section == section and "runs/mine" in c.text]
            if here and any(word in here[0] for word in ("evaluate", "ckpt=", "weights=")):
                if "first" not in made:
                    made["first"] = tmp_path_factory.mktemp("first")
                    run_in(made["first"], next(c.text for c in commands() if "run=runs/mine" in c.text))
                shutil.copytree(made["first"] / "runs" / "mine", folder / "runs" / "mine")
        return made[section]

    return place


def run_in(folder, text):
    """Run a command as a user types it, with this interpreter as `python`."""
    paths = [str(ROOT), str(ROOT / "plugins"), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {
        "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
        "PYTHONPATH": os.pathsep.join(paths),
    }
    done = subprocess.run(
        ["bash", "-c", text], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


def exact():
    """Commands without a word in capitals to fill in; once where they do not depend on earlier ones."""
    whole = [c for c in commands() if not re.search(r"[=\s][A-Z]+\b", c.text)]
    once = {(c.text, c.section if "run" in c.text else ""): c for c in whole}
    return [pytest.param(c, id=f"{c.section.split()[0]} {c.text}") for c in once.values()]


@pytest.mark.slow
@pytest.mark.parametrize("command", exact())
def test_a_documented_command_runs_as_printed(command, places):
    for part, reason in NOT_RUN.items():
        if part in command.text:
            pytest.skip(f"{command.text}: {reason}")
    run_in(places(command.section), command.text)


def test_entries_of_metrics_are_named_with_the_part_that_has_them():
    """Results of evaluations are under `plugins`; rows and training have parts of their own."""
    for document in DOCUMENTS:
        text = " ".join(document.read_text().split())
        for sentence in re.findall(r"[^.]*`metrics\.json`[^.]*(?:\.\w[^.]*)*\.", text):
            for place in re.findall(r"\b[uU]nder `([\w.]+)`", sentence):
                assert place.partition(".")[0] in ("plugins", "training", "rows", "about", "units"), (
                    document,
                    place,
                )
