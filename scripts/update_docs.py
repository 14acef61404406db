"""Refresh the generated tables and pictures of README and docs from data and finished studies.

A table stands between `<!-- table: NAME -->` and `<!-- end -->`. NAME is one of `GENERATED`, made
from the project's data, or a folder below --results that `cmf compare`, `cmf failure`,
`cmf modes` or `scripts/electronics_effect.py` wrote there with `--out`. Figures of the folders
`compare` and `modes` are copied to docs/images.
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
PAGES = (
    "README.md",
    "docs/model.md",
    "docs/failures.md",
    "docs/operation.md",
    "docs/modes.md",
    "docs/parameters.md",
)
TABLES = ("comparison.md", "failures.md", "modes.md")
FIGURES = {
    "compare": ("bode_surge.png", "bode_heave.png", "step_surge.png"),
    "modes": ("modes_sweep.png", "modes_map.png"),
}
_TABLE = re.compile(r"(<!-- table: ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def parameters(name: str) -> str:
    """A hydraulic set as a Markdown table."""
    return markdown(*parameter_cells(load_hydraulics(name)))


GENERATED: dict[str, Callable[[], str]] = {
    f"parameters-{name}": partial(parameters, name) for name in ("report", "hardware", "lossy")
}
"""Tables made from the project's data."""


def refresh(text: str, results: Path) -> str:
    """Replace every table of the project's data or whose study lies below `results`."""

    def replace(match: re.Match[str]) -> str:
        if match[2] in GENERATED:
            return f"{match[1]}\n{GENERATED[match[2]]()}\n{match[3]}"
        for name in TABLES:
            source = results / match[2] / name
            if source.is_file():
                return f"{match[1]}\n{source.read_text(encoding='utf-8')}\n{match[3]}"
        return match[0]

    return _TABLE.sub(replace, text)


def main() -> None:
    """Parse the arguments and rewrite the pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("out"))
    parser.add_argument("--root", type=Path, default=ROOT, help="checkout to rewrite")
    options = parser.parse_args()
    for name in PAGES:
        page = options.root / name
        page.write_text(refresh(page.read_text(encoding="utf-8"), options.results), "utf-8")
    for study, figures in FIGURES.items():
        for figure in figures:
            source = options.results / study / figure
            if source.is_file():
                shutil.copyfile(source, options.root / "docs" / "images" / figure)
    print(f"refreshed {', '.join(PAGES)}")


if __name__ == "__main__":
    main()
