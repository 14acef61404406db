"""Refresh the generated tables, numbers and pictures of README and docs from finished studies.

A table stands between `<!-- table: NAME -->` and `<!-- end -->`; NAME is a folder below --results
into which a command or script wrote it with `--out`, or FOLDER/TABLE where it wrote several.
Tables longer than a screen become files of docs/data, listed with their commits in `files.toml`
there; figures of the studies and of the gallery are copied to docs/images. What stands between
`<!-- data: NAME -->` and `<!-- end -->` is a data file as a table, or made from the package.

A number in a sentence is a cell of a data file:

    <!-- is: FILE / ROW / COLUMN -->2.55<!-- end -->

ROW are the first cells of the row, parted by `;`, `*` for any. A fourth part, `FORM`, says what is
shown of the cell: `#2` its second number, `abs` its size, `least` and `most` over all rows and all
columns (parted by `;`, `*` for any), `.1f` so many decimals, `down` and `up` rounded that way.
"""

import argparse
import csv
import hashlib
import io
import math
import re
import shutil
import subprocess
import textwrap
import tomllib
from collections.abc import Callable, Iterable
from functools import cache, partial
from pathlib import Path
from typing import Any

from typer.main import get_command

import cmf_mj.cli  # noqa: F401, registers every command with `app`
from cmf_mj import Hexapod, load_hydraulics, load_machine
from cmf_mj.cli.common import app
from cmf_mj.core import units
from cmf_mj.core.quantity import quantity_table
from cmf_mj.core.result import Table
from cmf_mj.report_2014.ledger import LedgerEntry, figures_text, load_ledger
from cmf_mj.show.linearization import mode_names

ROOT = Path(__file__).resolve().parents[1]
TABLES = (
    "comparison.md",
    "failures.md",
    "modes.md",
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
    "films/surge_heave.html": "_static/films/surge_heave.html",
    # cmf play surge_ring --laws velocity,position_error_rate --start 0.8 --seconds 3 --speed 0.25
    "films/surge_laws.html": "_static/films/surge_laws.html",
    # cmf play surge.toml heave.toml of docs/_static/course, as the lesson says
    "films/course.html": "_static/films/course.html",
    "films/cueing.html": "_static/films/cueing.html",
    **{
        f"course/step_{name}.csv{end}": f"_static/course/step_{name}.csv{end}"
        for name in ("surge", "heave")
        for end in ("", "-metadata.json")
    },
    **{f"course/{name}.html": f"_static/course/{name}.html" for name in ("exercises", "leg")},
    "course/gains.png": "images/course_gains.png",
    "course/fit.png": "images/course_fit.png",
    "films/valve_hard_over.html": "_static/films/valve_hard_over.html",
    "fit/report/stated.png": "images/calibration_report.png",
    "fit/hardware/stated.png": "images/calibration_hardware.png",
    "omct/omct.png": "images/omct.png",
    "fly/comparison.png": "images/fly_comparison.png",
    "fly/velocity/motion.png": "images/fly_motion.png",
    "certify/certificates.png": "images/certificates.png",
    "learning/turbulence/learning.png": "images/learn.png",
    "cueing/predictive.png": "images/predictive.png",
    "machines/machines.png": "images/two_machines.png",
    "verification/work_precision.png": "images/work_precision.png",
    "verification/crane.png": "images/crane.png",
    "ablation/ladder.png": "images/ladder.png",
    "stiffness/stiffness.png": "images/stiffness.png",
    "mismatch/rates.png": "images/mismatch_rates.png",
    **{
        f"rotation/{name}.png": f"images/rotation_{name}.png"
        for name in ("tornado", "bandwidths", "gains")
    },
}
"""Figures of the studies below --results, and where they go below docs."""
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


def listed(root: Path) -> dict[str, dict[str, str]]:
    """The data files with what `files.toml` says of each."""
    return tomllib.loads((root / "docs/data/files.toml").read_text(encoding="utf-8"))


def files(root: Path) -> str:
    """All data files by their groups, with links from the page of the reference."""
    groups: dict[str, list[tuple[str, ...]]] = {}
    for name, one in listed(root).items():
        link = f"[`{name}`](../data/{name}.csv)"
        commit = one["commit"] or "this one"
        groups.setdefault(one["group"], []).append((link, one["what"], one["command"], commit))
    header = ("file", "what it holds", "made by", "at commit")
    return "\n".join(
        f"**{name}**\n\n{Table('', header, rows).markdown()}" for name, rows in groups.items()
    )


def modes_neutral() -> str:
    """Modes of each cab of the CMF at neutral, as CSV."""
    rows: list[tuple[str, ...]] = []
    for cab in load_machine("cmf").cabs:
        found = Hexapod(cab).hydraulic_modes()
        modes = zip(mode_names(found), found.frequency_hz, found.leg_mass, strict=True)
        for name, frequency, mass in modes:
            mass = units.from_si("lbm", mass)
            rows.append((cab, name, f"{frequency:.2f}", f"{mass:.0f}", f"{mass / 1e3:.1f}"))
    return csv_text([("cab", "mode", "frequency [Hz]", "leg mass [lbm]", "[klbm]"), *rows])


def csv_text(rows: Iterable[Iterable[str]]) -> str:
    """Rows as CSV; of columns with one name the later ones get a number."""
    header, *rest = (list(row) for row in rows)
    names = [
        f"{name} {header[:i].count(name) + 1}" if name in header[:i] else name
        for i, name in enumerate(header)
    ]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([names, *rest])
    return text.getvalue()


def table_of(name: str, root: Path) -> str:
    """A data file as a Markdown table."""
    rows = _rows(root / f"docs/data/{name}.csv")
    names = [name[:-2] if name[:-2] in rows[0] else name for name in rows[0]]
    return Table("", tuple(names), [tuple(row.values()) for row in rows]).markdown()


def markdown_tables(text: str) -> list[str]:
    """The tables of a Markdown text, each as CSV."""
    found: list[list[list[str]]] = []
    before = ""
    for line in text.splitlines():
        if line.startswith("|"):
            if not before.startswith("|"):
                found.append([])
            cells = re.split(r"(?<!\\)\|", line.strip())[1:-1]
            found[-1].append([cell.strip().replace("\\|", "|") for cell in cells])
        before = line
    return [csv_text([rows[0], *rows[2:]]) for rows in found]


def take_files(root: Path, results: Path) -> None:
    """Take the data files whose studies lie below `results`, with their commit."""
    place = root / "docs/data/files.toml"
    text = place.read_text(encoding="utf-8")
    commit = _commit()
    for name, one in listed(root).items():
        source, _, number = one.get("source", "").partition("#")
        if not source or not (results / source).is_file():
            continue
        data = (results / source).read_text(encoding="utf-8")
        data = markdown_tables(data)[int(number or 0)] if source.endswith(".md") else data
        target = root / f"docs/data/{name}.csv"
        if not target.is_file() or target.read_text(encoding="utf-8") != data:
            target.write_text(data, "utf-8")
            text = _signed(text, name, commit, data)
    data = modes_neutral()
    (root / "docs/data/modes_neutral.csv").write_text(data, "utf-8")
    place.write_text(_signed(text, "modes_neutral", "", data), "utf-8")


def _commit() -> str:
    command = ["git", "rev-parse", "--short=10", "HEAD"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    return done.stdout.strip() or "unknown"


def _signed(text: str, name: str, commit: str, data: str) -> str:
    digest = hashlib.sha256(data.encode()).hexdigest()
    pattern = rf'(\[{name}\]\n(?:[a-z].*\n)*?)commit = ".*"\nsha256 = ".*"'
    new = rf'\g<1>commit = "{commit}"\nsha256 = "{digest}"'
    return re.sub(pattern, new, text)


@cache
def _rows(file: Path) -> tuple[dict[str, str], ...]:
    with file.open(encoding="utf-8", newline="") as lines:
        return tuple(csv.DictReader(lines))


def shown(text: str, root: Path = ROOT) -> str:
    """The number that `FILE / ROW / COLUMN / FORM` names, as it stands in a sentence."""
    name, row, columns, *form = text.split(" / ")
    keys = [key.strip() for key in row.split(";")]
    found = [
        one
        for one in _rows(root / f"docs/data/{name.strip()}.csv")
        if all(key in ("*", cell) for key, cell in zip(keys, one.values(), strict=False))
    ]
    words = " ".join(form).split()
    names = [column.strip() for column in columns.split(";")]
    if names == ["*"]:
        names = list(found[0])[len(keys) :]
    cells = [one[column] for one in found for column in names]
    if not cells or (len(cells) > 1 and not {"least", "most"} & set(words)):
        raise ValueError(f"{text.strip()}: {len(cells)} cells")
    return cells[0] if not words else _formed(cells, words)


def _formed(cells: list[str], words: list[str]) -> str:
    numbers = [re.findall(r"[-+]?\d+(?:\.\d+)?", cell) for cell in cells]
    which = next((int(word[1:]) - 1 for word in words if word.startswith("#")), 0)
    texts = [one[which] for one in numbers if len(one) > which]
    if "abs" in words:
        texts = [one.lstrip("+-") for one in texts]
    chosen = max(texts, key=float) if "most" in words else min(texts, key=float)
    decimals = next((int(word[1]) for word in words if word.startswith(".")), None)
    if decimals is None:
        return chosen
    scale = 10.0**decimals
    number = float(chosen) * scale
    number = math.floor(number + 1e-9) if "down" in words else number
    number = math.ceil(number - 1e-9) if "up" in words else number
    return f"{number / scale:.{decimals}f}"


DATA: dict[str, Callable[[], str]] = {
    "commands": commands,
    "ledger": ledger,
    **{f"parameters-{name}": partial(parameters, name) for name in ("report", "hardware", "lossy")},
}
"""What is made from data of the package, beside the data files and their list."""
_TABLE = re.compile(r"(<!-- table: ([\w/-]+) -->\n).*?(<!-- end -->)", re.DOTALL)
_DATA = re.compile(r"(<!-- data: ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)
_NUMBER = re.compile(r"(<!-- is: (.*?) -->).*?(<!-- end -->)", re.DOTALL)


def pages(root: Path) -> list[Path]:
    """README and all pages of the documentation."""
    return [root / "README.md", *sorted((root / "docs").rglob("*.md"))]


def refresh(text: str, results: Path, root: Path = ROOT) -> str:
    """Replace tables whose study lies below `results`, numbers, and what is made from data."""

    def replace(match: re.Match[str]) -> str:
        for source in (results / f"{match[2]}.md", *(results / match[2] / n for n in TABLES)):
            if source.is_file():
                text = source.read_text(encoding="utf-8")
                if text.startswith("# "):  # a page has titles and captions of its own
                    text = "".join(line for line in text.splitlines(True) if line[0] == "|")
                return f"{match[1]}\n{text}\n{match[3]}"
        return match[0]

    data = DATA | {"files": partial(files, root)}
    data |= {name: partial(table_of, name, root) for name in listed(root)}
    text = _DATA.sub(lambda match: f"{match[1]}\n{data[match[2]]()}\n{match[3]}", text)
    text = _NUMBER.sub(lambda match: f"{match[1]}{shown(match[2], root)}{match[3]}", text)
    return _TABLE.sub(replace, text)


def main() -> None:
    """Parse the arguments and rewrite the pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("out"))
    parser.add_argument("--root", type=Path, default=ROOT, help="checkout to rewrite")
    options = parser.parse_args()
    take_files(options.root, options.results)
    for page in pages(options.root):
        text = page.read_text(encoding="utf-8")
        page.write_text(refresh(text, options.results, options.root), "utf-8")
    for name, target in COPIES.items():
        source = options.results / name
        if source.is_file():
            shutil.copyfile(source, options.root / "docs" / target)
    for name in GALLERY:
        source = options.root / f"docs/gallery/images/sphx_glr_plot_{name}_002.png"
        if source.is_file():
            shutil.copyfile(source, options.root / f"docs/images/gallery_{name}.png")
    print(f"refreshed {', '.join(page.name for page in pages(options.root))}")


if __name__ == "__main__":
    main()
