"""The direction of imports, the size of files, and no print in the library."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LIBRARY = sorted((ROOT / "ahnn").rglob("*.py"))
PLUGINS = sorted((ROOT / "plugins").rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))

# Each part of the library and the parts that it may import; errors, arguments and progress are open to all.
OPEN = {"errors", "arguments", "progress", "types", "paths"}
MAY_IMPORT = {
    "__init__": set(),
    "errors": set(),
    "types": set(),
    "paths": set(),
    "progress": set(),
    "arguments": {"errors"},
    "profiler": set(),
    "integrators": OPEN,
    "normalisation": OPEN,
    "metrics": OPEN,
    "checkpoints": OPEN,
    "optim": OPEN,
    "systems": OPEN,
    "data": OPEN | {"integrators", "systems", "normalisation"},
    "models": OPEN | {"integrators", "normalisation", "optim"},
    "pretrained": OPEN | {"checkpoints"},
    "evaluation": OPEN | {"integrators", "metrics", "systems", "data", "models", "checkpoints", "pretrained"},
    "callbacks": OPEN | {"metrics", "data", "models", "evaluation"},
    "setup": OPEN | {"checkpoints", "data", "models"},
    "messages": OPEN,
    "config": OPEN | {"messages"},
    "train": OPEN | {"config", "data", "models", "evaluation", "setup", "callbacks"},
    "evaluate": OPEN | {"config", "train", "data", "models", "evaluation", "setup", "pretrained"},
}
HYDRA = {"train.py", "evaluate.py", "config.py", "messages.py", "evaluation/sweep.py"}


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


def test_the_rules_have_no_cycle():
    left = {key: value - {key} for key, value in MAY_IMPORT.items()}
    while left:
        free = [key for key, needs in left.items() if not needs & left.keys()]
        assert free, f"cycle among {sorted(left)}"
        for key in free:
            del left[key]


@pytest.mark.parametrize("path", LIBRARY, ids=name)
def test_the_library_never_names_a_plugin_and_hydra_stays_at_the_entry(path):
    modules = set(imports(path))
    assert not {m for m in modules if m.split(".")[0] in ("ahnn_plugins", "hydra_plugins", "optuna")}
    assert "ahnn_plugins" not in path.read_text()
    if str(path.relative_to(ROOT / "ahnn")) not in HYDRA:
        assert not {m for m in modules if m.split(".")[0] in ("hydra", "omegaconf")}


@pytest.mark.parametrize("path", PLUGINS, ids=name)
def test_plugins_import_no_entry_point_and_not_one_another(path):
    modules = set(imports(path))
    assert not modules & {"ahnn.train", "ahnn.evaluate", "ahnn.config"}
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
