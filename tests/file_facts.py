"""What the rules of the architecture ask of a file, read and parsed once."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]


def name(path):
    return str(path.relative_to(ROOT))


class Facts(NamedTuple):
    """What the rules ask of a file, which is read and parsed once."""

    lines: int
    docstring: str | None
    imports: frozenset[str]
    at_import: list[str]
    """Names that may be modules, imported when the file itself is."""
    prints: bool
    attached: list[int]
    """Lines that set an attribute of a model, of data or of a prepared training."""
    classes: list[str]
    checked: list[ast.ClassDef]
    """Protocols that are checked at run time."""


@cache
def facts(path):
    text = path.read_text()
    tree = ast.parse(text)
    nodes = list(ast.walk(tree))
    classes = [node for node in nodes if isinstance(node, ast.ClassDef)]
    return Facts(
        lines=len(text.splitlines()),
        docstring=ast.get_docstring(tree),
        imports=frozenset(imports(path, nodes)),
        at_import=[name for node in tree.body for name in candidates(node)],
        prints=any(
            isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
            for node in nodes
        ),
        attached=[line for node in nodes for line in attached(node)],
        classes=[node.name for node in tree.body if isinstance(node, ast.ClassDef)],
        checked=[c for c in classes if "runtime_checkable" in map(ast.unparse, c.decorator_list)],
    )


def imports(path, nodes):
    """Every module that a file imports, imports inside functions included."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name(path)}: a relative import"
            yield str(node.module)
            if node.module == "ahnn":
                yield from (f"ahnn.{alias.name}" for alias in node.names)


def candidates(node):
    """Names that may be modules in a statement that imports."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        names = [alias.name for alias in node.names]
        base = getattr(node, "module", None)
        yield from [base, *(f"{base}.{n}" for n in names)] if base else names


def attached(node):
    """The line of an assignment to an attribute of a model, of data or of a prepared training."""
    targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
    for target in targets:
        inner = target.value if isinstance(target, ast.Subscript) else target
        match inner:
            case ast.Attribute(ast.Name("model" | "pl_module" | "data" | "prepared")):
                yield inner.lineno
