"""The documentation site: Sphinx over the Markdown pages beside this file.

    make site    # builds it in build/site; a broken link or reference is an error

The machine, changes and contributing are models/README.md, CHANGELOG.md and CONTRIBUTING.md with
SECURITY.md, whose links are turned to where they lie from here. A link to the README leads to
the first page. Equations become MathML, so that a page needs neither a script nor the network.

The reference is read from the docstrings. They are plain text, equations set in by four columns,
while Sphinx reads reStructuredText: `as_restructured` stands between. With the compiler switched
off Numba leaves functions as they are, so that compiled ones are found as well.
"""

import gc
import logging
import os
import re
import sys
import tomllib
from functools import partial
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any

from docutils.nodes import SkipNode
from docutils.utils.math.latex2mathml import tex2mathml
from pygments.lexers.special import TextLexer
from sphinx.addnodes import toctree
from sphinx.domains.python import PythonDomain

sys.path.insert(0, str(Path(__file__).parent))  # thumbnails.py
os.environ["NUMBA_DISABLE_JIT"] = "1"
gc.set_threshold(200_000, 20, 100)  # pages are large trees, walked often for little garbage

project = "cmf-mj"
release = version = installed("cmf-mj")
copyright = "the authors of cmf-mj, MIT licence"
GALLERY = Path(__file__).parents[1] / "examples" / "gallery"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
]
if GALLERY.is_dir():
    extensions.append("sphinx_gallery.gen_gallery")
    # The scripts run in processes of their own, with the compiler.
    import numba  # noqa: F401, reads the switch

    os.environ["NUMBA_DISABLE_JIT"] = "0"
sphinx_gallery_conf = {
    "examples_dirs": str(GALLERY),
    "gallery_dirs": "gallery",
    "filename_pattern": "plot_",
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": ("thumbnails",),
    "min_reported_time": 1000,
    "show_memory": False,
    "show_signature": False,
    "abort_on_example_error": True,
    "parallel": 2,
}
templates_path = ["_templates"]
exclude_patterns = ["_templates", "data", "gallery/*.py", "gallery/*.ipynb"]
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "dollarmath"]
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_title = f"cmf-mj {release}"
default_role = "code"
highlight_language = "text"
autodoc_typehints = "description"
autodoc_member_order = "bysource"
autodoc_use_type_comments = False  # there are none, and looking for them takes time
suppress_warnings = ["ref.python"]  # a word before a colon under Returns is read as a type
autodoc_default_options = {"members": True, "ignore-module-all": True, "show-inheritance": True}

_HERE = Path(__file__).parent
_BORROWED = {
    "reference/parameters": "models/README.md",
    "reference/release": "CHANGELOG.md",
    "reference/contributing": "CONTRIBUTING.md",
}
_PLACES = {"README.md": "index", **{path: page for page, path in _BORROWED.items()}}
_PLACES["SECURITY.md"] = "reference/contributing"
_LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)#]+)")
_SECTION = re.compile(r"(Args|Returns|Raises|Yields|Attributes):$")
_ITEM = re.compile(r"\s*(- |\* |\d+\. )")


def as_restructured(lines: list[str]) -> list[str]:
    """Plain docstring as reStructuredText: what is set in is literal, lone | and * stand."""
    out: list[str] = []
    literal = listed = False
    for number, line in enumerate(lines):
        if _SECTION.match(line):
            return [*out, *(_escaped(rest) for rest in lines[number:])]
        inside = line.startswith(" ")
        listed = bool(_ITEM.match(line)) or (listed and (inside or not line))
        if inside and not literal and not listed:
            out += ["", "::", ""]
        elif literal and line and not inside:
            out += [""]
        literal = (inside or (literal and not line)) and not listed
        out.append(line if literal else _escaped(line))
    return out


_MARKED = re.compile(r"(`[^`]*`|\*\*[^*]+\*\*|(?<!\w)\*\w[^*]*[\w.]\*(?!\w))")


def _escaped(line: str) -> str:
    parts = _MARKED.split(line)
    parts[::2] = [re.sub(r"([|*]|_\b)", r"\\\1", plain) for plain in parts[::2]]
    return "".join(parts)


def _process(_app: Any, _kind: str, _name: str, _it: Any, _options: Any, lines: list[str]) -> None:
    lines[:] = as_restructured(lines)


def _read(_app: Any, page: str, source: list[str]) -> None:
    """Put the borrowed text before a page's own and turn all links between pages to the site's.

    Listings lose their empty last line.
    """
    own = _HERE / f"{page}.md"
    places = {_HERE.parent / path: _HERE / f"{name}.md" for path, name in _PLACES.items()}

    def turned(path: Path, match: re.Match[str]) -> str:
        target = Path(os.path.normpath(path.parent / match[1]))
        return os.path.relpath(places.get(target, target), own.parent)

    if own.is_file():
        source[0] = _LINK.sub(partial(turned, own), source[0]).replace("\n\n```\n", "\n```\n")
    if page in _BORROWED:
        borrowed = _HERE.parent / _BORROWED[page]
        text = borrowed.read_text(encoding="utf-8")
        if page == _PLACES["SECURITY.md"]:
            security = (_HERE.parent / "SECURITY.md").read_text(encoding="utf-8")
            text += "\n" + re.sub("^#", "##", security, flags=re.MULTILINE)
        source[0] = _LINK.sub(partial(turned, borrowed), text) + "\n" + source[0]


def _short_menu(app: Any, env: Any) -> None:
    """Keep modules out of the menu, which each page repeats: their rooms' pages list them."""
    for page, contents in env.tocs.items():
        if page.startswith("reference/api/cmf_mj."):
            for tree in list(contents.findall(toctree)):
                tree.parent.remove(tree)


def _mathml(translator: Any, node: Any) -> None:
    block = node.tagname == "math_block"
    translator.body.append(tex2mathml(node.astext(), as_block=block))
    raise SkipNode


def _paper(app: Any, page: str, *_rest: Any) -> None:
    """The style in which `make paper` prints one page."""
    if page == "explanation/paper":
        app.add_css_file("paper.css", media="print")


def _redirect(app: Any, error: Exception | None) -> None:
    """Leave a page that leads on where one was joined with another.

    The package sphinx-reredirects does the same; ten lines are less than one more to pin.
    """
    if error is not None or app.builder.format != "html":
        return
    pages = tomllib.loads((_HERE / "redirects.toml").read_text(encoding="utf-8"))
    for page, target in pages.items():
        place = Path(app.outdir) / f"{page}.html"
        place.parent.mkdir(parents=True, exist_ok=True)
        away = f'<meta http-equiv="refresh" content="0; url=../{target}">'
        link = f'<link rel="canonical" href="../{target}"><a href="../{target}">moved</a>'
        place.write_text(f"<!doctype html><title>moved</title>{away}{link}", encoding="utf-8")


class Names(PythonDomain):
    """Sphinx's domain of Python that searches all names only for a last part that one has.

    Most types in signatures are not of this package, and Sphinx compares each with the end of every
    name, which took half of the time of a build.
    """

    _ends: tuple[int, frozenset[str]] = 0, frozenset()

    def find_obj(self, *request: Any, **how: Any) -> Any:
        """Names that fit `name`, the fourth of the request, with what they are."""
        if self._ends[0] != len(self.objects):
            ends = frozenset(name.rpartition(".")[2] for name in self.objects)
            self._ends = len(self.objects), ends
        known = request[3].removesuffix("()").rpartition(".")[2] in self._ends[1]
        return super().find_obj(*request, **how) if known else []


def _of_a_generic(_app: object, _what: str, name: str, *_: object) -> bool | None:
    """Leave out classes that pydantic makes of a generic one, `Check[...]`."""
    return True if "[" in name else None


def setup(app: Any) -> None:
    """Read docstrings as they are written, borrow pages, write equations as MathML."""
    app.add_domain(Names, override=True)
    logging.getLogger("sphinx.sphinx.events").setLevel(logging.INFO)  # each event is a debug line
    app.connect("html-page-context", _paper)
    app.connect("autodoc-process-docstring", _process, priority=400)
    app.connect("autodoc-skip-member", _of_a_generic)
    app.connect("source-read", _read)
    app.connect("env-updated", _short_menu)
    app.connect("build-finished", _redirect)
    app.add_html_math_renderer("mathml", (_mathml, None), (_mathml, None))
    app.add_lexer("mermaid", TextLexer)
