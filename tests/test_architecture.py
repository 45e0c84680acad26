"""The direction of imports, the size of files, and no print in the library."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
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
    "pretrained": OPEN | {"checkpoints"},
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


def name(path):
    return str(path.relative_to(ROOT))


def imports(path):
    """Every module that a file imports, imports inside functions included."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name(path)}: a relative import"
            yield node.module
            if node.module == "ahnn":
                yield from (f"ahnn.{alias.name}" for alias in node.names)


def part(path):
    inner = path.relative_to(ROOT / "ahnn").parts
    return "__main__" if inner[-1] == "__main__.py" else inner[0].removesuffix(".py")


@pytest.mark.parametrize("path", LIBRARY, ids=name)
def test_imports_go_one_way(path):
    if part(path) in ENTRIES:
        return
    used = {module.split(".")[1] for module in imports(path) if module.startswith("ahnn.")}
    assert used - {"__version__"} <= MAY_IMPORT[part(path)] | {part(path)}


def test_every_room_has_its_rule_and_the_rules_have_no_cycle():
    assert {part(path) for path in LIBRARY} - ENTRIES == MAY_IMPORT.keys()
    left = {key: value - {key} for key, value in MAY_IMPORT.items()}
    while left:
        free = [key for key, needs in left.items() if not needs & left.keys()]
        assert free, f"cycle among {sorted(left)}"
        for key in free:
            del left[key]


@pytest.mark.parametrize("path", LIBRARY, ids=name)
def test_the_library_never_names_a_plugin_and_hydra_stays_at_the_doors(path):
    modules = set(imports(path))
    assert not {m for m in modules if m.split(".")[0] in ("ahnn_plugins", "hydra_plugins", "optuna")}
    assert "ahnn_plugins" not in path.read_text()
    if part(path) == "cli":
        return
    assert not {m for m in modules if m.split(".")[0] in ("hydra", "omegaconf")}
    assert "sys.exit" not in path.read_text()


@pytest.mark.parametrize("door", DOORS)
def test_doors_are_thin(door):
    path = ROOT / "ahnn" / f"{door}.py"
    ours = {tuple(m.split(".")[:2]) for m in imports(path) if m.startswith("ahnn")}
    assert ours <= {("ahnn", "cli"), ("ahnn", "jobs")}
    tree = ast.parse(path.read_text())
    assert sum(node.end_lineno - node.lineno + 1 for node in tree.body[1:]) <= 30
    assert path.read_text().endswith('if __name__ == "__main__":\n    main()\n')


def reached(*rooms):
    """The files that some rooms import when they are imported themselves, step by step."""
    names = {path: ".".join(path.relative_to(ROOT).with_suffix("").parts) for path in LIBRARY}
    files = {name.removesuffix(".__init__"): path for path, name in names.items()}
    todo, found = [m for m in files for room in rooms if f"{m}.".startswith(f"ahnn.{room}.")], set()
    while todo:
        module = todo.pop()
        if module in files and module not in found:
            found.add(module)
            for node in ast.parse(files[module].read_text()).body:
                if isinstance(node, ast.Import | ast.ImportFrom):
                    names = [a.name for a in node.names]
                    base = getattr(node, "module", None)
                    todo += [base, *(f"{base}.{n}" for n in names)] if base else names
    return found


def test_who_loads_predicts_evaluates_or_estimates_builds_no_optimiser_loader_or_trainer():
    jobs = ("jobs.predicting", "jobs.exporting", "jobs.evaluating", "jobs.assimilating")
    there = reached("loading", "prediction", "estimation", "assimilation", "evaluation", *jobs)
    trained = ("training", "models", "data.datamodule", "data.loader", "jobs.prepared")
    assert not {m for m in there if m.removeprefix("ahnn.").startswith(trained)}
    assert {"ahnn.dynamics.base", "ahnn.measurements.base"} <= there


def test_nothing_is_attached_to_a_model_by_another_module():
    """What a training adds to a model is given to its methods."""
    names = {"model", "pl_module", "data", "prepared"}
    for path in (*LIBRARY, *PLUGINS):
        for node in ast.walk(ast.parse(path.read_text())):
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            for target in targets:
                inner = target.value if isinstance(target, ast.Subscript) else target
                if isinstance(inner, ast.Attribute) and isinstance(inner.value, ast.Name):
                    assert inner.value.id not in names, f"{name(path)}:{inner.lineno}"


LIGHTNING = {"training/callbacks", "training/checkpoint_io.py", "training/restore.py", "jobs/prepared.py"}
LIGHTNING |= {"jobs/closing.py", "jobs/fitting_members.py", "models", "data/datamodule.py"}


@pytest.mark.parametrize("path", LIBRARY, ids=name)
def test_lightning_stays_where_training_is(path):
    inner = str(path.relative_to(ROOT / "ahnn"))
    if part(path) in ENTRIES or any(inner.startswith(place) for place in LIGHTNING):
        return
    assert not {m for m in imports(path) if m.split(".")[0] == "lightning"}


@pytest.mark.parametrize("path", PLUGINS, ids=name)
def test_plugins_import_no_entry_point_and_not_one_another(path):
    modules = set(imports(path))
    assert not modules & {"ahnn.train", "ahnn.evaluate", "ahnn.cli.build"}
    inner = path.relative_to(ROOT / "plugins").parts
    if inner[0] == "ahnn_plugins" and len(inner) > 2:
        others = {m.split(".")[1] for m in modules if m.startswith("ahnn_plugins.")}
        assert others <= {inner[1]}


@pytest.mark.parametrize("path", [*LIBRARY, *PLUGINS, *TESTS], ids=name)
def test_no_file_is_over_300_lines(path):
    assert len(path.read_text().splitlines()) <= 300


@pytest.mark.parametrize("path", [*LIBRARY, *PLUGINS], ids=name)
def test_nothing_is_printed(path):
    calls = [node.func for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
    assert not [call for call in calls if isinstance(call, ast.Name) and call.id == "print"]


def test_protocols_that_are_checked_at_run_time_have_methods_alone():
    """From Python 3.12 on a check looks past `__getattr__`, by which a module of torch gives its parts."""
    trees = [ast.parse(path.read_text()) for path in (*LIBRARY, *PLUGINS)]
    classes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    checked = [c for c in classes if "runtime_checkable" in map(ast.unparse, c.decorator_list)]
    assert len(checked) > 3
    for part in (part for c in checked for part in c.body[1:]):  # after the docstring
        assert isinstance(part, ast.FunctionDef), ast.unparse(part)
        assert not part.decorator_list, f"{part.name}: a property"


@pytest.mark.parametrize("path", [*LIBRARY, *PLUGINS], ids=name)
def test_every_file_says_what_it_is_for(path):
    assert ast.get_docstring(ast.parse(path.read_text()))


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
    trees = [ast.parse(path.read_text()) for path in (*LIBRARY, *PLUGINS)]
    classes = [node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef)]
    assert not {name for name in classes if classes.count(name) > 1}
