"""The documentation site: plain docstrings are read right, and a broken link is an error."""

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]


def loaded(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NUMBA_DISABLE_JIT", "0")
        spec.loader.exec_module(module)
    return module


def as_restructured(text: str) -> str:
    return "\n".join(loaded(ROOT / "docs" / "conf.py").as_restructured(text.split("\n")))


def test_equations_become_literal_and_signs_stand() -> None:
    said = as_restructured("The size |x| of a*b,\n\n    y = |x| * 2\n\nis **fixed**, `|x|` too.")
    assert r"size \|x\| of a\*b," in said
    assert "::\n\n    y = |x| * 2\n\n\nis **fixed**, `|x|` too." in said


def test_sections_are_left_to_their_reader() -> None:
    said = as_restructured("Mean.\n\nArgs:\n    x: |x| is at most 1.\n        More of it.")
    assert "::" not in said and r"    x: \|x\| is at most 1." in said


@pytest.mark.parametrize(
    ("text", "passes"),
    [
        ("[laws](../README.md) and [here](#second)\n\n## Second\n", True),
        ("[nothing](nothing.md)\n", False),
        ("[nothing](#third)\n\n## Second\n", False),
    ],
)
def test_a_broken_link_fails(tmp_path: Path, text: str, passes: bool) -> None:
    pages = tmp_path / "docs"
    pages.mkdir()
    shutil.copy(ROOT / "docs" / "conf.py", pages / "conf.py")
    (tmp_path / "README.md").write_text("# Overview\n")
    (pages / "index.md").write_text("```{toctree}\npage\n```\n")
    (pages / "page.md").write_text("# Page\n\n" + text)
    command = ["sphinx.cmd.build", "-q", "-W", str(pages), str(tmp_path / "site")]
    done = subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True)
    assert (done.returncode == 0) is passes, done.stderr


def test_every_page_is_in_the_contents() -> None:
    contents = (ROOT / "docs" / "index.md").read_text().split()
    assert {page.stem for page in (ROOT / "docs").glob("*.md")} - {"index"} <= set(contents)


def test_generated_tables_are_current(tmp_path: Path) -> None:
    """What the page says is what the data say; tables of studies are left alone."""
    script = loaded(ROOT / "scripts" / "update_docs.py")
    for path in script.pages(ROOT):
        page = path.read_text(encoding="utf-8")
        assert script.refresh(page, tmp_path) == page, f"run scripts/update_docs.py: {path.name}"
    page = (ROOT / "docs" / "parameters.md").read_text(encoding="utf-8")
    assert script.refresh(page.replace("0.28", "0.29"), tmp_path) == page
