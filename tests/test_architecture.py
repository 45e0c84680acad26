"""The direction of imports, the size of files, and no print in the library."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LIBRARY = sorted((ROOT / "ahnn").rglob("*.py"))
PLUGINS = sorted((ROOT / "plugins").rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))

# Each room of the library and the rooms that it may import; the open ones serve all.
OPEN = {"errors", "arguments", "numbers", "progress", "types", "paths", "files"}
GROUND = OPEN | {"integrators", "measurements", "metrics"}
TAUGHT = GROUND | {"dynamics", "systems", "data", "checkpoints"}
MAY_IMPORT = {
    "__init__": set(),
    "errors": set(),
    "types": set(),
    "paths": set(),
    "files": set(),
    "numbers": set(),
    "progress": set(),
    "arguments": {"errors"},
    "integrators": OPEN,
    "measurements": OPEN,
    "metrics": OPEN,
    "checkpoints": OPEN,
    "dynamics": GROUND,
    "systems": GROUND,
    "data": GROUND | {"systems", "dynamics"},
    "models": TAUGHT | {"training"},
    "training": TAUGHT | {"models", "evaluation"},
    "pretrained": OPEN | {"checkpoints"},
    "estimation": OPEN | {"measurements", "metrics"},
    "evaluation": TAUGHT | {"models", "pretrained"},
    "cli": TAUGHT | {"models", "training", "evaluation"},
    "train": TAUGHT | {"models", "training", "evaluation", "cli"},
    "evaluate": TAUGHT | {"models", "training", "evaluation", "cli", "pretrained", "train"},
}
HYDRA = {"train.py", "evaluate.py"}


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
    return inner[0].removesuffix(".py")


@pytest.mark.parametrize("path", LIBRARY, ids=name)
def test_imports_go_one_way(path):
    allowed = MAY_IMPORT[part(path)] | {part(path)}
    used = {module.split(".")[1] for module in imports(path) if module.startswith("ahnn.")}
    assert used <= allowed


@pytest.mark.parametrize("path", LIBRARY, ids=name)
def test_the_library_never_names_a_plugin_and_hydra_stays_at_the_entry(path):
    modules = set(imports(path))
    assert not {m for m in modules if m.split(".")[0] in ("ahnn_plugins", "hydra_plugins", "optuna")}
    assert "ahnn_plugins" not in path.read_text()
    if part(path) != "cli" and path.name not in HYDRA:
        assert not {m for m in modules if m.split(".")[0] in ("hydra", "omegaconf")}


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


@pytest.mark.parametrize("path", [*LIBRARY, *PLUGINS], ids=name)
def test_every_file_says_what_it_is_for(path):
    assert ast.get_docstring(ast.parse(path.read_text()))
