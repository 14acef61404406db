"""Refresh the generated tables and pictures of README and docs from data and finished studies.

A table stands between `<!-- table: NAME -->` and `<!-- end -->`; NAME is a folder below --results
into which a command or script wrote it with `--out`, or FOLDER/TABLE where it wrote several.
Figures of the studies and of the gallery are copied to docs/images, numbers to docs/data. What
stands between `<!-- data: NAME -->` and `<!-- end -->` is made from data of the package and needs
no study.
"""

import argparse
import re
import shutil
import textwrap
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from typer.main import get_command

import cmf_mj.cli  # noqa: F401, registers every command with `app`
from cmf_mj import load_hydraulics
from cmf_mj.cli.common import app
from cmf_mj.core.quantity import quantity_table
from cmf_mj.core.result import Table
from cmf_mj.report_2014.ledger import LedgerEntry, figures_text, load_ledger

ROOT = Path(__file__).resolve().parents[1]
TABLES = (
    "comparison.md",
    "failures.md",
    "modes.md",
    "calibration.md",
    "omct.md",
    "share.md",
    "work_precision.md",
    "bench.md",
    "host_gains.md",
)
COPIES = {
    "compare/bode_surge.png": "images/bode_surge.png",
    "compare/bode_heave.png": "images/bode_heave.png",
    "compare/step_surge.png": "images/step_surge.png",
    "modes/modes_sweep.png": "images/modes_sweep.png",
    "modes/modes_map.png": "images/modes_map.png",
    "films/surge_heave.mp4": "_static/films/surge_heave.mp4",
    "films/modes_gfd.mp4": "_static/films/modes.mp4",
    "films/valve_hard_over.mp4": "_static/films/valve_hard_over.mp4",
    "calibrate/report/residuals.png": "images/calibration_report.png",
    "calibrate/hardware/residuals.png": "images/calibration_hardware.png",
    "omct/omct.png": "images/omct.png",
    "omct/omct.csv": "data/omct.csv",
    "host_gains/host_gains.csv": "data/host_gains.csv",
    "fly/comparison.png": "images/fly_comparison.png",
    "fly/velocity/motion.png": "images/fly_motion.png",
    "certify/certificates.png": "images/certificates.png",
    "certify/certificates.csv": "data/certificates.csv",
    "certify_all/certificates.csv": "data/certificates_all.csv",
    "certify_full/certificates.csv": "data/certificates_full.csv",
    "learning/turbulence/learning.png": "images/learn.png",
    "learning/learning.csv": "data/learning.csv",
    "machines/machines.png": "images/two_machines.png",
    "verification/work_precision.png": "images/work_precision.png",
    "capacity/envelope.png": "images/envelope.png",
    "ablation/ladder.png": "images/ladder.png",
    "stiffness/stiffness.png": "images/stiffness.png",
    "ablation/measures.csv": "data/ablation_measures.csv",
    "ablation/effects.csv": "data/ablation_effects.csv",
    "mismatch/rates.csv": "data/mismatch_rates.csv",
    "mismatch/rates.png": "images/mismatch_rates.png",
    **{
        f"rotation/{name}.csv": f"data/rotation_{name}.csv"
        for name in ("stability", "changes", "spans", "gains", "unknowns", "evidence")
    },
    **{
        f"rotation/{name}.png": f"images/rotation_{name}.png"
        for name in ("unknowns", "tornado", "maps", "bandwidths", "gains")
    },
}
"""Files of the studies below --results, and where they go below docs."""
GALLERY = ("machine", "step_six_axes")
"""Scripts of the gallery whose pictures README shows, as the last build of the site made them."""


def parameters(name: str) -> str:
    """A hydraulic set as a Markdown table."""
    return quantity_table("", load_hydraulics(name).quantities()).markdown()


def ledger() -> str:
    """A list of contents as a table, then a section an entry."""
    contents = Table(
        "",
        ("no.", "where", "what"),
        [(str(entry.number), entry.where, entry.title) for entry in load_ledger()],
    )
    return contents.markdown() + "".join(f"\n{_section(entry)}" for entry in load_ledger())


def _section(entry: LedgerEntry) -> str:
    points = (
        ("Printed", entry.printed),
        ("Finding", entry.finding),
        ("Figures", figures_text(entry)),
        ("Here", entry.project),
        ("Shown by", f"`{entry.demonstration}`"),
    )
    lines = [
        textwrap.fill(f"- {name}: {text}.", 116, subsequent_indent="  ", break_long_words=False)
        for name, text in points
    ]
    return f"## {entry.number}. {entry.title}\n\n{entry.where}.\n\n" + "\n".join(lines) + "\n"


def commands() -> str:
    """All commands by the headings of `cmf --help`, each with its first sentence."""
    panels: dict[str, list[tuple[str, ...]]] = {}

    def gather(group: Any, before: str, heading: str) -> None:
        for name, command in sorted(group.commands.items()):
            panel = command.rich_help_panel or heading
            if hasattr(command, "commands"):
                gather(command, f"{before} {name}", panel)
            if not getattr(command, "invoke_without_command", True):
                continue
            sentence = command.help.split("\n\n")[0].replace("\n", " ")
            panels.setdefault(panel, []).append((f"`{before} {name}`", sentence))

    gather(get_command(app), "cmf", "")
    tables = (
        f"## {panel}\n\n{Table('', ('command', 'what it does'), rows).markdown()}"
        for panel, rows in sorted(panels.items())
    )
    return "\n".join(tables)


DATA: dict[str, Callable[[], str]] = {
    "commands": commands,
    "ledger": ledger,
    **{f"parameters-{name}": partial(parameters, name) for name in ("report", "hardware", "lossy")},
}
"""What is made from data of the package."""
_TABLE = re.compile(r"(<!-- table: ([\w/-]+) -->\n).*?(<!-- end -->)", re.DOTALL)
_DATA = re.compile(r"(<!-- data: ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def pages(root: Path) -> list[Path]:
    """README and all pages of the documentation."""
    return [root / "README.md", *sorted((root / "docs").rglob("*.md"))]


def refresh(text: str, results: Path) -> str:
    """Replace every table whose study lies below `results`, and what is made from data."""

    def replace(match: re.Match[str]) -> str:
        for source in (results / f"{match[2]}.md", *(results / match[2] / n for n in TABLES)):
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
    for name, target in COPIES.items():
        source = options.results / name
        if source.is_file():
            shutil.copyfile(source, options.root / "docs" / target)
    for name in GALLERY:
        source = options.root / f"docs/gallery/images/sphx_glr_plot_{name}_001.png"
        if source.is_file():
            shutil.copyfile(source, options.root / f"docs/images/gallery_{name}.png")
    print(f"refreshed {', '.join(page.name for page in pages(options.root))}")


if __name__ == "__main__":
    main()
