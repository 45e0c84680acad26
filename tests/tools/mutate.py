"""Mutation of the numerical kernels: single changes of operators and constants, and whether a test notices.

    python tests/tools/mutate.py --seed 0 --count 64 [--only PART]

Each mutant is one change in a copy of the tree; the tests nearest to its file run against it. What survives
is printed with its place, to be tested or to be explained. A mutant that runs out of time counts as noticed.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
UKF, PFL = "plugins/ahnn_plugins/ukf", "plugins/ahnn_plugins/pfl"
KERNELS: dict[str, list[str]] = {
    "ahnn/integrators": ["tests/integrators"],
    "ahnn/dynamics": ["tests/dynamics", "tests/models"],
    "ahnn/training": ["tests/training", "tests/models"],
    "ahnn/data": ["tests/data"],
    "ahnn/statistics.py": ["tests/data", "tests/dynamics"],
    "ahnn/rollouts.py": ["tests/test_rollouts.py", "tests/evaluation"],
    "ahnn/metrics.py": ["tests/test_metrics.py"],
    "ahnn/measurements": ["tests/measurements", "tests/plugins/ukf"],
    "ahnn/estimation": ["tests/estimation", "tests/plugins/ukf"],
    UKF: ["tests/plugins/ukf", "tests/estimation"],
    PFL: ["tests/plugins/pfl"],
}
"""Kernels and the tests nearest to them."""

SHELLS = (
    "__init__.py",
    "callbacks",
    "figures.py",
    "plugin.py",
    "series.py",
    "checkpoint_io.py",
    "profiler.py",
)
"""What is no kernel: pictures, plumbing and names."""

SWAPS: dict[type, type] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Pow: ast.Mult,
    ast.MatMult: ast.Mult,
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}


def main() -> None:
    """Draw mutants, run the tests nearest to them and print what survives."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=64)
    parser.add_argument("--only", default="", help="part of a path")
    parser.add_argument("--timeout", type=float, default=300, help="seconds for the tests of one mutant")
    options = parser.parse_args()
    drawn = [m for m in mutants() if options.only in str(m[0])]
    random.Random(options.seed).shuffle(drawn)
    drawn = drawn[: options.count]
    survivors = 0
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        ignored = shutil.ignore_patterns(".git", ".venv", "__pycache__", "runs", "multirun", ".*_cache")
        shutil.copytree(ROOT, tree, ignore=ignored)
        for number, (path, index) in enumerate(drawn, 1):
            changed, what = mutated(path, index)
            noticed = is_noticed(tree, path, changed, options.timeout)
            survivors += not noticed
            if not noticed:
                say(f"SURVIVED {path.relative_to(ROOT)}:{what}")
            elif number % 8 == 0:
                say(f"{number} of {len(drawn)}, {survivors} survived")
    share = 100 * (1 - survivors / max(1, len(drawn)))
    say(f"seed {options.seed}: {len(drawn) - survivors} of {len(drawn)} noticed, {share:.1f} %")


def mutants() -> Iterator[tuple[Path, int]]:
    """Yield every place that can be changed: a file and the number of the change in it."""
    for kernel in KERNELS:
        for path in files(ROOT / kernel):
            yield from ((path, index) for index in range(len(places(ast.parse(path.read_text())))))


def files(kernel: Path) -> list[Path]:
    """Return the files of a kernel."""
    found = [kernel] if kernel.suffix else sorted(kernel.rglob("*.py"))
    return [path for path in found if not any(part in SHELLS for part in path.parts)]


def places(tree: ast.Module) -> list[ast.AST]:
    """Return the nodes of a module that can be changed, annotations, messages and texts left out."""
    left_out: set[int] = set()
    for node in ast.walk(tree):
        hidden: list[ast.AST | None] = []
        if isinstance(node, ast.FunctionDef):
            hidden = [node.returns, *(a.annotation for a in (*node.args.args, *node.args.kwonlyargs))]
        elif isinstance(node, ast.AnnAssign):
            hidden = [node.annotation]
        elif (
            isinstance(node, ast.Raise | ast.JoinedStr)
            or (isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in ("message", "__all__"))
            or (isinstance(node, ast.Assign) and "Literal" in ast.unparse(node.value))
        ):
            hidden = [node]
        for part in hidden:
            left_out.update(id(inner) for inner in ast.walk(part) if part is not None) if part else None
    return [node for node in ast.walk(tree) if id(node) not in left_out and can_change(node)]


def can_change(node: ast.AST) -> bool:
    """Return whether there is a change for a node."""
    if isinstance(node, ast.BinOp):
        return type(node.op) in SWAPS and not _is_type(node)
    if isinstance(node, ast.Compare):
        return type(node.ops[0]) in SWAPS
    if isinstance(node, ast.BoolOp):
        return True
    if isinstance(node, ast.UnaryOp):
        return isinstance(node.op, ast.USub | ast.Not)
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def _is_type(node: ast.BinOp) -> bool:
    """Return whether a | b is a union of types."""
    return isinstance(node.op, ast.BitOr) and any(
        isinstance(side, ast.Name) and side.id[:1].isupper() for side in (node.left, node.right)
    )


def mutated(path: Path, index: int) -> tuple[str, str]:
    """Return the source with one change, and the change in words."""
    tree = ast.parse(path.read_text())
    node = places(tree)[index]
    before = ast.unparse(node)
    if isinstance(node, ast.BinOp | ast.BoolOp):
        node.op = SWAPS[type(node.op)]()
    elif isinstance(node, ast.Compare):
        node.ops[0] = SWAPS[type(node.ops[0])]()
    elif isinstance(node, ast.UnaryOp):
        node.op = ast.UAdd() if isinstance(node.op, ast.USub) else ast.Not()
        if isinstance(node.op, ast.Not):
            node.operand = ast.UnaryOp(ast.Not(), node.operand)
    elif isinstance(node, ast.Constant):
        value = node.value
        assert isinstance(value, int | float)
        node.value = value + 1 if isinstance(value, int) else (value * 1.5 if value else 1.0)
    after = ast.unparse(node)
    return ast.unparse(tree), f"{getattr(node, 'lineno', 0)}: {before}  ->  {after}"


def is_noticed(tree: Path, path: Path, changed: str, timeout: float) -> bool:
    """Return whether the nearest tests fail on a change."""
    inner = path.relative_to(ROOT)
    kernel = max((k for k in KERNELS if str(inner).startswith(k)), key=len)
    tests = [t for t in KERNELS[kernel] if (tree / t).exists()]
    original = (tree / inner).read_text()
    (tree / inner).write_text(changed)
    env = os.environ | {"PYTHONPATH": f"{tree}{os.pathsep}{tree / 'plugins'}", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(command, cwd=tree, env=env, capture_output=True, timeout=timeout, check=False)
    except subprocess.TimeoutExpired:
        return True
    finally:
        (tree / inner).write_text(original)
    return done.returncode != 0


def say(text: str) -> None:
    """Write a line at once: a session takes minutes."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
