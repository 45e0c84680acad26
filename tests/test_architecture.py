"""The direction of imports, the size of files, and no print in the library."""

from __future__ import annotations

import ast
import re
import subprocess
import sys

import pytest
from file_facts import ROOT, facts, name

LIBRARY = sorted((ROOT / "ahnn").rglob("*.py"))
PLUGINS = sorted((ROOT / "plugins").rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))

# Each room of the library and the rooms that it may import; the open ones serve all.
OPEN = {
    "errors",
    "arguments",
    "contents",
    "files",
    "locks",
    "manifest",
    "memory",
    "numbers",
    "progress",
    "types",
    "paths",
    "extensions",
    "cores",
    "jacobians",
    "compiled_libraries",
    "deviations",
    "substeps",
    "clock",
    "controls",
    "stored",
    "labels",
    "optional_libraries",
}
GROUND = OPEN | {"integrators", "measurements", "metrics", "rollouts", "statistics", "checkpoints"}
MAY_IMPORT = {key: set() for key in ("clock", "errors", "extensions", "locks", "paths", "progress")} | {
    "optional_libraries": {"errors"},
    "workers": {"errors", "optional_libraries"},
    "types": {"clock", "errors"},
    "numbers": {"errors"},
    "controls": {"errors", "numbers"},
    "cores": set(),
    "jacobians": {"cores"},
    "contents": {"errors"},
    "manifest": {"errors"},
    "files": {"errors", "locks", "manifest"},
    "memory": {"errors"},
    "substeps": {"types"},
    "compiled_libraries": {"contents", "files", "paths", "types"},
    "arguments": {"errors"},
    "stored": {"arguments", "errors", "types"},
    "deviations": {"errors", "numbers", "types"},
    "labels": {"errors", "types"},
    "metrics": OPEN,
    "rollouts": OPEN,
    "statistics": OPEN,
    "checkpoints": OPEN,
    "integrators": OPEN,
    "measurements": OPEN,
    "dynamics": GROUND,
    "systems": GROUND | {"dynamics"},
    "data": GROUND | {"systems"},
    "tracking": GROUND | {"data", "shooting", "systems"},
    "tasks": GROUND | {"systems"},
    "shooting": OPEN | {"measurements"},
    "uncertainty": GROUND | {"dynamics", "shooting"},
    "training": GROUND | {"dynamics", "data", "shooting", "uncertainty"},
    "models": GROUND | {"dynamics", "training"},
    "estimation": GROUND | {"systems", "data", "dynamics", "shooting"},
    "evaluation": GROUND | {"dynamics", "systems", "data", "estimation", "shooting", "uncertainty"},
    "graphs": GROUND | {"dynamics", "evaluation", "runs"},
    "prediction": GROUND | {"dynamics", "data", "evaluation", "shooting", "uncertainty"},
    "assimilation": GROUND | {"data", "estimation", "evaluation"},
    "pretrained": OPEN,
    "runs": GROUND | {"dynamics", "evaluation", "prediction", "uncertainty"},
    "papers": {"loading", "runs"},
    "loading": GROUND | {"dynamics", "pretrained", "runs", "uncertainty"},
    "ensembles": GROUND | {"dynamics", "loading", "prediction", "runs", "uncertainty"},
    "saving": GROUND | {"data", "dynamics", "loading", "runs", "uncertainty"},
    "untrained": GROUND | {"data", "dynamics"},
    "jobs": GROUND
    | {"assimilation", "data", "dynamics", "evaluation", "graphs", "models", "prediction", "pretrained"}
    | {"estimation", "loading", "runs", "shooting", "systems", "tracking", "training", "uncertainty"}
    | {"ensembles", "workers"},
}
ENTRIES = {
    "train",
    "evaluate",
    "predict",
    "export",
    "assimilate",
    "report",
    "reproduce",
    "benchmark",
    "calibrate",
    "plan",
    "orbit",
    "fitting",
    "cli",
    "__init__",
    "__main__",
}
"""The doors of the house: they may import every room, and no room imports them."""
DOORS = [
    *("train", "evaluate", "predict", "export", "assimilate", "report", "reproduce", "benchmark", "orbit"),
    *("calibrate", "plan"),
    "data/__main__",
]
"""What users call: a command line goes in, `cli` makes values of it, and `jobs` does what they say."""


def part(path):
    inner = path.relative_to(ROOT / "ahnn").parts
    return "__main__" if inner[-1] == "__main__.py" else inner[0].removesuffix(".py")


def test_imports_go_one_way():
    wrong = {}
    for path in LIBRARY:
        if part(path) not in ENTRIES:
            used = {m.split(".")[1] for m in facts(path).imports if m.startswith("ahnn.")}
            wrong[name(path)] = used - {"__version__"} - MAY_IMPORT[part(path)] - {part(path)}
    assert len(wrong) > 100
    assert not {path: modules for path, modules in wrong.items() if modules}


def test_every_room_has_its_rule_and_the_rules_have_no_cycle():
    assert {part(path) for path in LIBRARY} - ENTRIES == MAY_IMPORT.keys()
    left = {key: value - {key} for key, value in MAY_IMPORT.items()}
    while left:
        free = [key for key, needs in left.items() if not needs & left.keys()]
        assert free, f"cycle among {sorted(left)}"
        for key in free:
            del left[key]


def roots(path):
    """The packages that a file imports."""
    return {module.split(".")[0] for module in facts(path).imports}


def test_the_library_never_names_a_plugin_and_hydra_stays_at_the_doors():
    for path in LIBRARY:
        text = path.read_text()
        assert not roots(path) & {"ahnn_plugins", "hydra_plugins", "optuna"}, name(path)
        assert "ahnn_plugins" not in text, name(path)
        if part(path) != "cli":
            assert not roots(path) & {"hydra", "omegaconf"}, name(path)
            assert "sys.exit" not in text, name(path)


@pytest.mark.parametrize("door", DOORS)
def test_doors_are_thin(door):
    path = ROOT / "ahnn" / f"{door}.py"
    ours = {tuple(m.split(".")[:2]) for m in facts(path).imports if m.startswith("ahnn")}
    assert ours <= {("ahnn", "cli"), ("ahnn", "jobs")}
    tree = ast.parse(path.read_text())
    assert sum((node.end_lineno or 0) - node.lineno + 1 for node in tree.body[1:]) <= 30
    assert path.read_text().endswith('if __name__ == "__main__":\n    main()\n')


def reached(*rooms) -> set[str]:
    """The files that some rooms import when they are imported themselves, step by step."""
    names = {path: ".".join(path.relative_to(ROOT).with_suffix("").parts) for path in LIBRARY}
    files = {name.removesuffix(".__init__"): path for path, name in names.items()}
    todo, found = [m for m in files for room in rooms if f"{m}.".startswith(f"ahnn.{room}.")], set()
    while todo:
        module = todo.pop()
        if module in files and module not in found:
            found.add(module)
            todo += facts(files[module]).at_import
    return found


def test_who_loads_predicts_evaluates_or_estimates_builds_no_optimiser_loader_or_trainer():
    jobs = ("jobs.predicting", "jobs.exporting", "jobs.evaluating", "jobs.assimilating")
    there = reached("loading", "prediction", "estimation", "assimilation", "evaluation", *jobs)
    trained = ("training", "models", "data.datamodule", "data.loader", "jobs.prepared")
    assert not {m for m in there if m.removeprefix("ahnn.").startswith(trained)}
    assert {"ahnn.dynamics.base", "ahnn.measurements.base"} <= there


def test_nothing_is_attached_to_a_model_by_another_module():
    """What a training adds to a model is given to its methods."""
    assert not [f"{name(path)}:{line}" for path in (*LIBRARY, *PLUGINS) for line in facts(path).attached]


LIGHTNING = {"training/callbacks", "training/checkpoint_io.py", "training/restore.py", "jobs/prepared.py"}
LIGHTNING |= {"jobs/closing.py", "models", "data/datamodule.py"}


def test_lightning_stays_where_training_is():
    others = [path for path in LIBRARY if part(path) not in ENTRIES]
    places = tuple(str(ROOT / "ahnn" / place) for place in LIGHTNING)
    assert not [
        name(path) for path in others if "lightning" in roots(path) and not str(path).startswith(places)
    ]


def test_plugins_import_no_entry_point_and_not_one_another():
    for path in PLUGINS:
        modules = facts(path).imports
        assert not modules & {"ahnn.train", "ahnn.evaluate", "ahnn.cli.build"}, name(path)
        inner = path.relative_to(ROOT / "plugins").parts
        if inner[0] == "ahnn_plugins" and len(inner) > 2:
            others = {m.split(".")[1] for m in modules if m.startswith("ahnn_plugins.")}
            assert others <= {inner[1]}, name(path)


def test_no_file_is_over_300_lines():
    assert not [name(path) for path in (*LIBRARY, *PLUGINS) if facts(path).lines > 300]
    assert not [name(path) for path in TESTS if len(path.read_text().splitlines()) > 300]


def test_nothing_is_printed():
    assert not [name(path) for path in (*LIBRARY, *PLUGINS) if facts(path).prints]


def test_protocols_that_are_checked_at_run_time_have_methods_alone():
    """From Python 3.12 on a check looks past `__getattr__`, by which a module of torch gives its parts."""
    checked = [c for path in (*LIBRARY, *PLUGINS) for c in facts(path).checked]
    assert len(checked) > 3
    for part in (part for c in checked for part in c.body[1:]):  # after the docstring
        assert isinstance(part, ast.FunctionDef), ast.unparse(part)
        assert not part.decorator_list, f"{part.name}: a property"


def test_every_file_says_what_it_is_for():
    assert not [name(path) for path in (*LIBRARY, *PLUGINS) if not facts(path).docstring]


def test_what_a_run_leaves_at_the_root_changes_no_verdict_of_the_linter(tmp_path):
    """Folders named as modules that tests import, such as runs/, once moved their imports."""
    for path in (*TESTS, ROOT / "pyproject.toml"):
        copied = tmp_path / path.relative_to(ROOT)
        copied.parent.mkdir(parents=True, exist_ok=True)
        copied.write_text(path.read_text())
    lines = "\n".join(path.read_text() for path in TESTS)
    modules = {*re.findall(r"^(?:from|import) (\w+)", lines, re.MULTILINE)} - {"ahnn", "tests"}
    assert {"runs", "helpers", "cases", "entry"} <= modules
    for module in modules:
        (tmp_path / module).mkdir(exist_ok=True)
    command = [sys.executable, "-m", "ruff", "check", "--no-cache", "--select", "I", "tests"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


TWICE = {"arguments", "attraction", "bands", "base", "consistency", "energies", "fitting", "forecast"}
TWICE |= {"online", "orbits", "paths", "plugin", "progress", "reading", "results", "samples", "satellites"}
TWICE |= {"scores", "settings"}
"""Names of files that stand in two rooms, for the same thing seen from each."""


def test_no_name_stands_for_two_things():
    files = [path.stem for path in (*LIBRARY, *PLUGINS) if not path.stem.startswith("__")]
    assert {name for name in files if files.count(name) > 1} == TWICE
    classes = [name for path in (*LIBRARY, *PLUGINS) for name in facts(path).classes]
    assert not {name for name in classes if classes.count(name) > 1}
