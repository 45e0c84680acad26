"""The documentation's site: every page is in its navigation, every public name is described."""

from __future__ import annotations

import inspect
import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = {str(path.relative_to(ROOT / "docs")) for path in (ROOT / "docs").rglob("*.md")}
MADE = re.findall(r'^    "(ahnn[\w.]*)": ', (ROOT / "docs" / "reference_pages.py").read_text(), re.MULTILINE)
NAVIGATION = (ROOT / "mkdocs.yml").read_text()


@pytest.mark.parametrize("page", sorted(PAGES))
def test_a_page_is_in_the_navigation(page):
    assert re.search(rf"[\s/]{re.escape(page)}$", NAVIGATION, re.MULTILINE)


@pytest.mark.parametrize("room", MADE)
def test_public_names_of_a_room_are_described_with_their_members(room):
    assert f"reference/python/{room.replace('.', '_')}.md" in NAVIGATION
    module = import_module(room)
    for name in module.__all__:
        found = getattr(module, name)
        if inspect.isclass(found) or inspect.isfunction(found):
            assert inspect.getdoc(found), name
        if inspect.isclass(found):
            for member, value in vars(found).items():
                if inspect.isfunction(value) and not member.startswith("_"):
                    assert inspect.getdoc(value), f"{name}.{member}"


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("mkdocs", path=Path(sys.executable).parent) is None, reason="the extra `docs` is needed"
)
def test_the_site_is_built_without_a_warning(tmp_path):
    words = [str(Path(sys.executable).parent / "mkdocs"), "build", "--site-dir", str(tmp_path)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
