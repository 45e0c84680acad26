"""Pages of the site's reference, made from the code: Python, configuration, commands, glossary.

MkDocs runs it (`make docs`); pages exist in the site alone.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import mkdocs_gen_files

from ahnn.papers import PAPERS, entries

ROOT = Path(__file__).parents[1]
ROOMS = {
    "ahnn": "What most scripts need.",
    "ahnn.systems": "Simulated systems: what they are, where their trajectories begin.",
    "ahnn.dynamics": "What is learned, as plain modules.",
    "ahnn.dynamics.forces": "Forces beside a Hamiltonian, known or learned.",
    "ahnn.integrators": "Integrators as tables of numbers.",
    "ahnn.measurements": "What instruments give.",
    "ahnn.data": "Sources of trajectories, windows, splits.",
    "ahnn.models": "LightningModules, one for each model.",
    "ahnn.training": "Objectives, optimisers and schedules.",
    "ahnn.evaluation": "Cases, rows and results.",
    "ahnn.estimation": "What every estimator shares.",
    "ahnn.assimilation": "Streams of measurements.",
    "ahnn.prediction": "States to come.",
    "ahnn.uncertainty": "Posterior, bands, novelty.",
    "ahnn.tasks": "Tasks of the field.",
    "ahnn_plugins.ukf": "Unscented Kalman filter and smoother.",
    "ahnn_plugins.ekf": "Extended Kalman filter.",
    "ahnn_plugins.enkf": "Ensemble Kalman filter.",
    "ahnn_plugins.particle": "Particle filter.",
    "ahnn_plugins.imm": "Interacting multiple models.",
}
"""Rooms with public names, in the order of the navigation, and what they hold."""
COMMANDS = (
    *("train", "evaluate", "predict", "assimilate", "orbit", "data"),
    *("plan", "export", "report", "reproduce", "benchmark", "calibrate"),
)


def source(room: str) -> Path:
    """Return the file of a room."""
    path = Path(*room.split("."))
    found = [ROOT / base / path for base in ("", "plugins")]
    (folder,) = [one for one in found if one.is_dir()]
    return folder / "__init__.py"


def public(room: str) -> list[str]:
    """Return the names in `__all__` that are classes or functions somewhere in the room."""
    for node in ast.parse(source(room).read_text()).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return [name for name in ast.literal_eval(node.value) if name[0].isalpha()]
    return []


def python_pages() -> None:
    """Write a page for each room, and one that lists them."""
    rows = ["# Python\n", "| module | what it has |", "|---|---|"]
    for room, about in ROOMS.items():
        page = f"python/{room.replace('.', '_')}.md"
        rows.append(f"| [`{room}`]({page}) | {about} |")
        text = f"# {room}\n\n{about}\n\n"
        text += "\n\n".join(f"::: {room}.{name}" for name in public(room))
        with mkdocs_gen_files.open(f"reference/{page}", "w") as file:
            file.write(text + "\n")
    with mkdocs_gen_files.open("reference/python.md", "w") as file:
        file.write("\n".join(rows) + "\n")


def configuration_page() -> None:
    """Write all options of all groups with their keys and comments."""
    parts = [
        "# Configuration\n",
        "A command composes one option of each group and sets single keys,",
        "`GROUP=OPTION` and `group.key=VALUE`.",
        "What the command line names holds over every option.\n",
        "## The training\n",
        f"```yaml\n{(ROOT / 'conf' / 'train.yaml').read_text()}```\n",
    ]
    for folder in sorted((ROOT / "conf").iterdir()):
        if not folder.is_dir() or folder.name == "hydra":
            continue
        parts.append(f"## {folder.name}\n")
        for option in sorted(folder.glob("*.yaml")):
            parts += [f"### {folder.name}={option.stem}\n", f"```yaml\n{option.read_text().rstrip()}\n```\n"]
    with mkdocs_gen_files.open("reference/configuration.md", "w") as file:
        file.write("\n".join(parts))


def commands_page() -> None:
    """Write what `--help` of each command prints."""
    parts = ["# Commands\n"]
    for name in COMMANDS:
        words = [sys.executable, "-m", f"ahnn.{name}", "--help"]
        shown = subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOT).stdout
        parts.append(f"## python -m ahnn.{name}\n\n```text\n{shown.rstrip()}\n```\n")
    with mkdocs_gen_files.open("reference/commands.md", "w") as file:
        file.write("\n".join(parts))


def glossary_page() -> None:
    """Write the words of the contributors' guide."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \| [^|]+ \|$", text, re.MULTILINE)
    entries = sorted((word, meaning) for word, meaning in rows if word != "word" and "---" not in word)
    with mkdocs_gen_files.open("reference/glossary.md", "w") as file:
        file.write("# Glossary\n\n| word | meaning |\n|---|---|\n")
        file.writelines(f"| {word} | {meaning} |\n" for word, meaning in entries)


def papers_page() -> None:
    """Write the papers for each method, as text and BibTeX."""
    parts = [
        "# Papers\n",
        "`ahnn.citations(run)` returns the papers for the methods that a run used. `print` shows them as",
        "text; the attribute `bibtex` has their entries.\n",
    ]
    for key, paper in entries().items():
        methods = ", ".join(f"`{name}`" for name, keys in PAPERS.items() if key in keys)
        parts.append(f"**{methods}**: {paper}\n")
    bibtex = "\n".join(paper.bibtex for paper in entries().values())
    parts.append(f"## BibTeX\n\n```bibtex\n{bibtex}\n```")
    with mkdocs_gen_files.open("reference/papers.md", "w") as file:
        file.write("\n".join(parts) + "\n")


python_pages()
papers_page()
configuration_page()
commands_page()
glossary_page()
