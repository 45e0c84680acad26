"""Mutation of the numerical kernels: single changes of operators and constants, and whether a test notices.

    python tests/tools/mutate.py --seed 0 --count 64 [--only PART] [--each]

Each mutant is one change in a copy of the tree; the tests that execute its line run against it
(`nearest.py`). What survives is printed with its place, to be tested or to be explained. A mutant that runs
out of time counts as noticed.

Left out is what changes nothing by construction: annotations and messages; the sign of an axis or an index,
whose number is changed instead; tolerances and cuts far from every size that occurs; how much work is
done, in constants whose words say that it is so much "at once", "at most" or "about".
"""

from __future__ import annotations

import argparse
import ast
import random
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from nearest import Reach, noticed

ROOT = Path(__file__).parents[2]
UKF, PFL = "plugins/ahnn_plugins/ukf", "plugins/ahnn_plugins/pfl"
KERNELS = (
    "ahnn/integrators",
    "ahnn/dynamics",
    "ahnn/training",
    "ahnn/shooting",
    "ahnn/uncertainty",
    "ahnn/data",
    "ahnn/statistics.py",
    "ahnn/rollouts.py",
    "ahnn/metrics.py",
    "ahnn/measurements",
    "ahnn/estimation",
    UKF,
    PFL,
)
TESTS = (
    *(f"tests/{name}" for name in ("integrators", "dynamics", "models", "training", "data", "systems")),
    *(f"tests/{name}" for name in ("shooting", "uncertainty")),
    *(
        f"tests/{name}"
        for name in ("measurements", "estimation", "assimilation", "plugins/ukf", "plugins/pfl")
    ),
    *(f"tests/{name}" for name in ("test_metrics.py", "test_statistics.py", "test_rollouts.py")),
    *(f"tests/{name}" for name in ("test_restoring.py", "test_checkpoints.py")),
    *("tests/evaluation/test_open_loop.py", "tests/prediction/test_starts_from_files.py"),
    *("tests/tracking", "tests/test_own_data.py"),
)
"""Where the tests of the kernels are."""

NEGLIGIBLE, HUGE = 1e-8, 1e200
"""Constants beyond these are tolerances and cuts."""

CHOSEN = ("at once", "at most", "about")
"""What the words below a constant say where somebody chose how much work is done, which no oracle knows."""

SHELLS = (
    "__init__.py",
    "callbacks",
    "figures.py",
    "plugin.py",
    "series.py",
    "checkpoint_io.py",
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
    parser.add_argument("--each", action="store_true", help="so many of each kernel")
    parser.add_argument("--only", default="", help="part of a path")
    parser.add_argument("--timeout", type=float, default=90, help="seconds for the tests of one mutant")
    parser.add_argument(
        "--store",
        type=Path,
        default=Path(tempfile.gettempdir()) / "ahnn_reach.json",
        help="of what tests reach",
    )
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        ignored = shutil.ignore_patterns(".git", ".venv", "__pycache__", "runs", "multirun", ".*_cache")
        shutil.copytree(ROOT, tree, ignore=ignored)
        reach = Reach(tree, options.store)
        reach.measure(TESTS)
        shares: dict[str, list[bool]] = {}
        for path, index in drawn(options.seed, options.count, options.each, options.only):
            caught = judge(reach, path, index, options.timeout)
            shares.setdefault(kernel_of(path), []).append(caught)
    for kernel, caught in shares.items():
        say(f"{kernel}: {sum(caught)} of {len(caught)} noticed")
    caught = [c for some in shares.values() for c in some]
    share = 100 * sum(caught) / max(1, len(caught))
    say(f"seed {options.seed}: {sum(caught)} of {len(caught)} noticed, {share:.1f} %")


def drawn(seed: int, count: int, each: bool, only: str) -> list[tuple[Path, int]]:
    """Return the mutants of a seed, those of a kernel one after the other."""
    known = [m for m in mutants() if only in str(m[0])]
    random.Random(seed).shuffle(known)
    by_kernel = {k: [m for m in known if kernel_of(m[0]) == k] for k in KERNELS}
    if each:
        return [m for some in by_kernel.values() for m in some[:count]]
    chosen = set(known[:count])
    return [m for some in by_kernel.values() for m in some if m in chosen]


def kernel_of(path: Path) -> str:
    """Return the kernel that a file is part of."""
    inner = str(path.relative_to(ROOT))
    return max((k for k in KERNELS if inner.startswith(k)), key=len)


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
    left_out = {id(inner) for part in chosen(tree) for inner in ast.walk(part)}
    for node in ast.walk(tree):
        hidden: list[ast.AST | None] = []
        if isinstance(node, ast.FunctionDef):
            hidden = [node.returns, *(a.annotation for a in (*node.args.args, *node.args.kwonlyargs))]
        elif isinstance(node, ast.AnnAssign):
            hidden = [node.annotation]
        elif isinstance(node, ast.UnaryOp) and ast.unparse(node) in ("-1", "-2", "-3"):
            left_out.add(id(node))
        elif (
            isinstance(node, ast.Raise | ast.JoinedStr)
            or (isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in ("message", "__all__"))
            or (isinstance(node, ast.Assign) and "Literal" in ast.unparse(node.value))
        ):
            hidden = [node]
        for part in hidden:
            left_out.update(id(inner) for inner in ast.walk(part) if part is not None) if part else None
    return [node for node in ast.walk(tree) if id(node) not in left_out and can_change(node)]


def chosen(tree: ast.Module) -> list[ast.stmt]:
    """Return the constants of a module that say how much work is done."""
    pairs = zip(tree.body, tree.body[1:], strict=False)
    return [
        node
        for node, below in pairs
        if isinstance(node, ast.Assign)
        and isinstance(below, ast.Expr)
        and any(word in ast.unparse(below).split("\\n")[0].lower() for word in CHOSEN)
    ]


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
    if not isinstance(node, ast.Constant) or type(node.value) not in (int, float):
        return False
    return node.value == 0 or NEGLIGIBLE < node.value < HUGE


def _is_type(node: ast.BinOp) -> bool:
    """Return whether a | b is a union of types."""
    return isinstance(node.op, ast.BitOr) and any(
        isinstance(side, ast.Name) and side.id[:1].isupper() for side in (node.left, node.right)
    )


def mutated(path: Path, index: int) -> tuple[str, int, int, str]:
    """Return the source with one change, its first and last line, and the change in words."""
    tree = ast.parse(path.read_text())
    node = places(tree)[index]
    first, last = lines_of(tree, node)
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
    return ast.unparse(tree), first, last, f"{getattr(node, 'lineno', 0)}: {before}  ->  {after}"


def lines_of(tree: ast.Module, node: ast.AST) -> tuple[int, int]:
    """Return the lines of the innermost statement around a node; of a compound one, the node's."""
    statements = [s for s in ast.walk(tree) if isinstance(s, ast.stmt) and node in ast.walk(s)]
    inner = min(statements, key=lambda s: (s.end_lineno or 0) - s.lineno)
    own = node if hasattr(inner, "body") else inner
    return own.lineno, own.end_lineno  # pyright: ignore[reportAttributeAccessIssue]


def judge(reach: Reach, path: Path, index: int, timeout: float) -> bool:
    """Return whether the nearest tests notice a mutant, and say so if they do not."""
    changed, first, last, what = mutated(path, index)
    inner = str(path.relative_to(ROOT))
    room = inner.replace("plugins/ahnn_plugins/", "tests/plugins/").replace("ahnn/", "tests/", 1)
    near = room.rsplit("/", 1)[0]
    names = reach.tests(inner, first, last, near)
    target = reach.tree / inner
    original = target.read_text()
    for compiled in target.parent.glob(f"__pycache__/{target.stem}.*.pyc"):
        compiled.unlink()
    target.write_text(changed)
    try:
        caught = bool(names) and noticed(reach.tree, names, timeout)
    finally:
        target.write_text(original)
    if not caught:
        say(f"SURVIVED {inner}:{what}   ({len(names)} tests)")
    return caught


def say(text: str) -> None:
    """Write a line at once: a session takes minutes."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
