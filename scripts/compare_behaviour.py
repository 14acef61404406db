"""Are two commits the same machine? Runs of both compared bit for bit.

Each commit is exported into a folder of its own and runs there: every scenario of
tests/references/behaviour.toml, the shipped scenario with a host, replay of a record, open-loop
valves, the excavator, a flight, and the default `cmf compare`. Records are compared column by
column, CSV files byte by byte. Ends with status 1 where anything differs or is missing.
"""

import argparse
import os
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

CASES = Path("tests/references/behaviour.toml")
"""Scenarios; those of this checkout run at both commits."""

VALUES = Path("tests/references/behaviour_values.toml")
"""Key values of their records, which tests/across/test_behaviour.py holds on any processor."""

KEY_CHANNELS = ("leg_reference", "leg_extension", "valve_command", "cap_pressure", "leg_force")

FLIGHT = "doublets"

_CMF = "from cmf_mj.cli import main; main()"

_PROGRAMS = {
    "open_loop": """
import numpy as np, cmf_mj
time = np.arange(4096) / 2048.0
valves = 0.1 * np.sin(2 * np.pi * np.outer(time, [1.0, 1.5, 2.0, 0.5, 2.5, 3.0]))
cmf_mj.drive(cmf_mj.Hexapod(), valves).save("OUT/record.parquet")
""",
    "excavator": """
import numpy as np, cmf_mj
names = ("boom_cylinder", "stick_cylinder", "bucket_cylinder")
models = "ROOT/models/"
oil = models + "excavator_hydraulics.toml"
plant = cmf_mj.attach_hydraulics(models + "excavator.xml", names, oil)
time = np.arange(6144)[:, None] / 2048.0
path = plant.extensions() + 0.02 * (1.0 - np.cos(2 * np.pi * time / 3.0)) * [1.0, -1.0, 1.0]
start = plant.configuration(path[0])
law = models + "excavator_laws.toml"
cmf_mj.simulate(plant, law, path, legs=True, start=start, record_every=4).save("OUT/record.parquet")
""",
}
"""Programs by name: `OUT` is their folder, `ROOT` that of the commit."""


def main() -> int:
    """Run both commits and say what differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("base", help="commit to compare with")
    parser.add_argument("head", nargs="?", help="default: the working tree")
    parser.add_argument("--out", type=Path, default=Path("out/behaviour"))
    parser.add_argument("--no-compare", action="store_true", help="leave out `cmf compare`")
    parser.add_argument("--only", help="names of cases, comma-separated")
    parser.add_argument("--keep", action="store_true", help=f"write the base's {VALUES.name}")
    options = parser.parse_args()
    folders = []
    for commit in (options.base, options.head):
        root = Path().resolve() if commit is None else export(commit, options.out)
        results = options.out / "results" / (root.name if commit else "working_tree")
        runs = runs_of(root, results, not options.no_compare)
        chosen = options.only.split(",") if options.only else list(runs)
        for name in chosen:
            run_case(root, results / name, runs[name])
        folders.append(results)
    if options.keep:
        _keep(folders[0])
    differing = _differences(folders[0], folders[1], chosen)
    for line in differing:
        print(line)
    compared = sum(1 for case in chosen for _ in (folders[0] / case).rglob("*.parquet"))
    print(f"{compared} records: " + (f"{len(differing)} differences" if differing else "same bits"))
    return 1 if differing else 0


def key_values(columns: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Root mean square of each key channel, (N, n), in SI, and of its last row."""
    values = {}
    for name in KEY_CHANNELS:
        values[name] = float(np.sqrt(np.mean(columns[name] ** 2)))
        values[f"{name}_last"] = float(np.sqrt(np.mean(columns[name][-1] ** 2)))
    return values


def _keep(results: Path) -> None:
    lines = ["# Written by scripts/compare_behaviour.py --keep: root mean squares in SI.", ""]
    for case in tomllib.loads(CASES.read_text(encoding="utf-8")):
        table = pq.read_table(results / case / "record.parquet")
        columns = {
            name: np.column_stack([table[f"{name}_{leg}"].to_numpy() for leg in range(1, 7)])
            for name in KEY_CHANNELS
        }
        lines.append(f"[{case}]")
        lines += [f"{name} = {value:.9g}" for name, value in key_values(columns).items()]
        lines.append("")
    VALUES.write_text("\n".join(lines), encoding="utf-8")


def export(commit: str, out: Path) -> Path:
    """The folder of a commit's sources below `out`."""
    digest = subprocess.run(
        ["git", "rev-parse", "--short=12", f"{commit}^{{commit}}"],
        check=True, capture_output=True, text=True,
    ).stdout.strip()  # fmt: skip
    root = (out / digest).resolve()
    if not root.is_dir():
        root.mkdir(parents=True)
        archive = subprocess.run(["git", "archive", digest], check=True, capture_output=True)
        subprocess.run(["tar", "-x", "-C", root], input=archive.stdout, check=True)
    return root


def runs_of(root: Path, results: Path, comparison: bool) -> dict[str, list[str]]:
    """Arguments of the interpreter for each case."""
    runs = {}
    for name, table in tomllib.loads(CASES.read_text(encoding="utf-8")).items():
        file = results / f"{name}.toml"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(_toml(table), encoding="utf-8")
        runs[name] = ["-c", _CMF, "run", str(file), "--out", str(results / name)]
    host = str(root / "scenarios" / "host_flight.toml")
    runs["host"] = ["-c", _CMF, "run", host, "--out", str(results / "host")]
    recording = str(results / "position_error_rate_noisy" / "record.parquet")
    runs["replay"] = ["-c", _CMF, "replay", recording, "--out", str(results / "replay")]
    runs["flight"] = ["-c", _CMF, "fly", FLIGHT, "--out", str(results / "flight")]
    for name, program in _PROGRAMS.items():
        text = program.replace("OUT", str(results / name)).replace("ROOT", str(root))
        runs[name] = ["-c", text]
    if comparison:
        runs["compare"] = ["-c", _CMF, "compare", "--out", str(results / "compare")]
    return runs


def _toml(table: dict[str, object]) -> str:
    import tomlkit

    return tomlkit.dumps(table)


def run_case(root: Path, folder: Path, arguments: list[str]) -> None:
    """Run a case of `runs_of` with the sources of a commit, or of the working tree."""
    if folder.is_dir() and root != Path().resolve():
        return  # of a commit: cannot have changed
    folder.mkdir(parents=True, exist_ok=True)
    arguments = [
        part.replace(str(folder.parent), str(folder.parent.resolve())) for part in arguments
    ]
    print(f"{root.name}: {folder.name}", flush=True)
    environment = {**os.environ, "PYTHONPATH": str(root)}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=root, env=environment, capture_output=True, text=True
    )
    (folder / "printed.txt").write_text(done.stdout, encoding="utf-8")
    if done.returncode:
        print(f"{folder.name}: ended with status {done.returncode}\n{done.stderr[-2000:]}")


def _differences(base: Path, head: Path, cases: list[str]) -> list[str]:
    said = []
    paths = (path for case in cases for path in sorted((base / case).rglob("*")))
    for path in paths:
        name = path.relative_to(base)
        other = head / name
        if path.suffix not in (".parquet", ".csv"):
            continue
        if not other.is_file():
            said.append(f"{name}: missing")
        elif path.suffix == ".csv":
            if path.read_bytes() != other.read_bytes():
                said.append(f"{name}: differs")
        else:
            said += [f"{name}: {column}" for column in _columns(path, other)]
    return said


def _columns(path: Path, other: Path) -> list[str]:
    """Columns of two Parquet files that differ in name or in any bit."""
    one, two = pq.read_table(path), pq.read_table(other)
    odd = [f"{name} is in one only" for name in set(one.column_names) ^ set(two.column_names)]
    for name in one.column_names:
        if name in two.column_names:
            left, right = (np.asarray(table[name].to_numpy()) for table in (one, two))
            if left.tobytes() != right.tobytes():
                same = left.shape == right.shape
                by = f" by up to {np.abs(left - right).max():.3g}" if same else ""
                odd.append(f"{name} differs{by}")
    return odd


if __name__ == "__main__":
    sys.exit(main())
