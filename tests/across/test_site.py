"""The documentation site: plain docstrings are read right, and a broken link is an error."""

import importlib.util
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest
from docutils.nodes import make_id

import cmf_mj

ROOT = Path(__file__).resolve().parents[2]
PARTS = ("tutorials", "how_to", "explanation", "reference")
REDIRECTS = tomllib.loads((ROOT / "docs" / "redirects.toml").read_text(encoding="utf-8"))


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
        ("Energy $E = m v^2 / 2$ and\n\n$$ M = J^{-T} M J^{-1} $$\n", True),
        ("[nothing](nothing.md)\n", False),
        ("[nothing](#third)\n\n## Second\n", False),
    ],
)
def test_a_broken_link_fails(tmp_path: Path, text: str, passes: bool) -> None:
    pages = tmp_path / "docs"
    pages.mkdir()
    for name in ("conf.py", "redirects.toml"):
        shutil.copy(ROOT / "docs" / name, pages / name)
    shutil.copytree(ROOT / "docs" / "_static", pages / "_static")
    (tmp_path / "README.md").write_text("# Overview\n")
    (pages / "index.md").write_text("```{toctree}\npage\n```\n")
    (pages / "page.md").write_text("# Page\n\n" + text)
    command = ["sphinx.cmd.build", "-q", "-W", str(pages), str(tmp_path / "site")]
    done = subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True)
    assert (done.returncode == 0) is passes, done.stderr
    if passes:
        for page, target in REDIRECTS.items():
            moved = (tmp_path / "site" / f"{page}.html").read_text(encoding="utf-8")
            assert f'content="0; url=../{target}"' in moved


@pytest.mark.parametrize(("page", "target"), REDIRECTS.items())
def test_a_page_that_is_gone_leads_to_one_that_is_there(page: str, target: str) -> None:
    """Never to another redirect, and to a heading of the page, by the name that Sphinx gives it."""
    place, _, heading = target.partition("#")
    assert not (ROOT / "docs" / f"{page}.md").exists()
    text = (ROOT / "docs" / place).with_suffix(".md").read_text(encoding="utf-8")
    assert not heading or heading in map(make_id, re.findall(r"^#+ (.*)$", text, re.MULTILINE))


def test_every_page_is_in_the_contents() -> None:
    """In one of the four parts, and in the list of `index.md`, so that none is out of reach."""
    docs = ROOT / "docs"
    contents = (docs / "index.md").read_text(encoding="utf-8").split()
    pages = {str(page.relative_to(docs).with_suffix("")) for page in docs.rglob("*.md")}
    assert pages - {"index"} <= set(contents)
    assert {Path(page).parent.name for page in pages} == {"", *PARTS}


def test_every_public_name_is_in_the_index_by_task() -> None:
    page = (ROOT / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
    listed = {line.strip().split(".")[-1] for line in page.split("## All modules")[0].splitlines()}
    assert set(cmf_mj.__all__) - {"signals"} <= listed


def test_generated_tables_are_current(tmp_path: Path) -> None:
    """What the page says is what the data say; tables of studies are left alone."""
    script = loaded(ROOT / "scripts" / "update_docs.py")
    for path in script.pages(ROOT):
        page = path.read_text(encoding="utf-8")
        assert script.refresh(page, tmp_path) == page, f"run scripts/update_docs.py: {path.name}"
    page = (ROOT / "docs" / "reference" / "parameters.md").read_text(encoding="utf-8")
    assert script.refresh(page.replace("0.28", "0.29"), tmp_path) == page
