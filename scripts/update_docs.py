"""Refresh the generated tables and pictures of README and docs from data and finished studies.

A table stands between `<!-- table: NAME -->` and `<!-- end -->`; NAME is a folder below --results
into which a command or script wrote it with `--out`. Figures of the studies are copied to
docs/images. What stands between `<!-- data: NAME -->` and `<!-- end -->` is made from data of the
package and needs no study.
"""

import argparse
import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

from cmf_mj import load_hydraulics
from cmf_mj.report import markdown, parameter_cells

ROOT = Path(__file__).resolve().parents[1]
TABLES = ("comparison.md", "failures.md", "modes.md", "work_precision.md")
FIGURES = {
    "compare/bode_surge.png": "bode_surge.png",
    "compare/bode_heave.png": "bode_heave.png",
    "compare/step_surge.png": "step_surge.png",
    "modes/modes_sweep.png": "modes_sweep.png",
    "modes/modes_map.png": "modes_map.png",
    "verification/work_precision.png": "work_precision.png",
}
"""Figures of the studies below --results, and their names in docs/images."""


def parameters(name: str) -> str:
    """A hydraulic set as a Markdown table."""
    return markdown(*parameter_cells(load_hydraulics(name)))


DATA: dict[str, Callable[[], str]] = {
    f"parameters-{name}": partial(parameters, name) for name in ("report", "hardware", "lossy")
}
"""What is made from data of the package."""
_TABLE = re.compile(r"(<!-- table: ([\w/-]+) -->\n).*?(<!-- end -->)", re.DOTALL)
_DATA = re.compile(r"(<!-- data: ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def pages(root: Path) -> list[Path]:
    """README and all pages of the documentation."""
    return [root / "README.md", *sorted((root / "docs").glob("*.md"))]


def refresh(text: str, results: Path) -> str:
    """Replace every table whose study lies below `results`, and what is made from data."""

    def replace(match: re.Match[str]) -> str:
        for name in TABLES:
            source = results / match[2] / name
            if source.is_file():
                return f"{match[1]}\n{source.read_text(encoding='utf-8')}\n{match[3]}"
        return match[0]

    text = _DATA.sub(lambda match: f"{match[1]}\n{DATA[match[2]]()}\n{match[3]}", text)
    return _TABLE.sub(replace, text)


def main() -> None:
    """Parse the arguments and rewrite the pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("out"))
    parser.add_argument("--root", type=Path, default=ROOT, help="checkout to rewrite")
    options = parser.parse_args()
    for page in pages(options.root):
        page.write_text(refresh(page.read_text(encoding="utf-8"), options.results), "utf-8")
    for figure, name in FIGURES.items():
        source = options.results / figure
        if source.is_file():
            shutil.copyfile(source, options.root / "docs" / "images" / name)
    print(f"refreshed {', '.join(page.name for page in pages(options.root))}")


if __name__ == "__main__":
    main()
