"""What has changed since the last release: its responses under those of this checkout.

    python scripts/compare_releases.py v0.1.0

Both run the cases of `compare_behaviour.py` and frequency responses of four laws on both plants.
Where a history differs by more than TOLERANCE of what it spans in its case, `releases.toml` says
why. Status 1 where it does not, and where it explains what is not there. The page is a table and a
figure of all responses, the last release's broad and pale, this one's thin and dark.
"""

import argparse
import csv
import sys
import tomllib
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pyarrow.parquet as pq
from compare_behaviour import export, run_case, runs_of
from numpy.typing import NDArray

from cmf_mj.show.look import frequency_axis

TOLERANCE = 1e-3
"""Largest difference that needs no explanation, of what the channel spans in the case."""

EXPLAINED = Path(__file__).with_name("releases.toml")
"""Tables `[[change]]` with `base`, `cases`, `channels` and `why`; names may hold `*`."""

CHANNELS = (
    *("demand_pose", "leg_reference", "leg_extension", "leg_velocity", "leg_acceleration"),
    *("valve_command", "cap_pressure", "rod_pressure", "leg_force", "supply_pressure"),
)
"""Histories that are compared; those of all legs are one channel."""

LAWS, MOVED = ("original", "velocity", "acceleration_d2", "modal_plan"), ("heave", "surge", "roll")

RESPONSES = f"""
import csv, cmf_mj
rows = []
for law in {LAWS}:
    for plant, dof in (("single_legs", "heave"), *(("hexapod", dof) for dof in {MOVED})):
        command = cmf_mj.signals.multisine(dof, 0.005, period=4.0, periods=2)
        machine = cmf_mj.SingleLegs() if plant == "single_legs" else cmf_mj.Hexapod()
        response = cmf_mj.frequency_response(cmf_mj.simulate(machine, law, command), dof)
        points = zip(response.frequency, response.gain_db, response.phase_deg)
        rows += [(f"{{plant}}, {{dof}}", law, *map(float, point)) for point in points]
with open("OUT/responses.csv", "w", newline="") as file:
    csv.writer(file).writerows(rows)
"""

History = tuple[NDArray[np.float64], NDArray[np.float64]]  # abscissa (N,), values (N, n)


class Difference(NamedTuple):
    """How far a channel of a case is from the last release's."""

    case: str
    channel: str
    share: float  #: Of what it spans there; infinite where it is in one only.
    before: History
    after: History
    why: str = ""


def histories(folder: Path) -> dict[str, History]:
    """Compared channels of a case's record, or gain and phase of each response."""
    found: dict[str, History] = {}
    for path in folder.rglob("*.parquet"):
        table = pq.read_table(path)
        time = table["time"].to_numpy()
        for channel in CHANNELS:
            names = [n for n in table.column_names if n.rpartition("_")[0] == channel]
            if channel in table.column_names:
                names = [channel]
            if names:
                values = np.column_stack([table[name].to_numpy() for name in names])
                found[channel] = time, values
    for path in folder.glob("responses.csv"):
        lines = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
        for key in dict.fromkeys((place, law) for place, law, *_ in lines):
            rows = np.array([line[2:] for line in lines if tuple(line[:2]) == key], dtype=float)
            found[": ".join(key)] = rows[:, 0], rows[:, 1:]
    return found


def differences(case: str, base: Path, head: Path) -> Iterator[Difference]:
    """Every channel of a case, with how far it is from the last release's."""
    before, after = histories(base / case), histories(head / case)
    nothing = np.empty(0), np.empty((0, 1))
    for channel in dict.fromkeys([*before, *after]):
        one, two = before.get(channel, nothing), after.get(channel, nothing)
        share = np.inf
        if one[1].shape == two[1].shape and np.array_equal(one[0], two[0]):
            apart, span = np.abs(one[1] - two[1]).max(axis=0), np.ptp(one[1], axis=0)
            if case != "responses":  # legs and axes that hardly move count as the others
                span[:] = span.max()
            share = float((apart[apart > 0.0] / span[apart > 0.0]).max(initial=0.0))
        yield Difference(case, channel, share, one, two)


def explain(
    found: list[Difference], changes: list[dict[str, Any]]
) -> tuple[list[Difference], set[int]]:
    """The same with what explains them; and the explanations that nothing needs."""
    unused, explained = set(range(len(changes))), []
    for each in found:
        for number, change in enumerate(changes):
            fits = any(fnmatch(each.case, name) for name in change["cases"])
            fits &= any(fnmatch(each.channel, name) for name in change.get("channels", ["*"]))
            if each.share > TOLERANCE and fits:
                each = each._replace(why=change["why"])
                unused.discard(number)
                break
        explained.append(each)
    return explained, unused


def figure(found: list[Difference], base: str, path: Path) -> None:
    """Gain and phase of the responses, then each case's channel with the largest difference."""
    responses = [d for d in found if d.case == "responses"]
    places = list(dict.fromkeys(d.channel.partition(": ")[0] for d in responses))
    cases = [c for c in dict.fromkeys(d.case for d in found) if c != "responses"]
    shown = [max((d for d in found if d.case == c), key=lambda d: d.share) for c in cases]
    shown = [
        next(o for o in found if o.case == d.case and o.channel == "leg_extension")
        if d.share == 0.0 and any(o.case == d.case and o.channel == "leg_extension" for o in found)
        else d
        for d in shown
    ]
    rows = 2 + -(-len(shown) // 4)
    page, axes = plt.subplots(rows, 4, figsize=(11.0, 1.75 * rows), layout="constrained")
    for place, column in zip(places, axes[:2].T, strict=True):
        for d in (d for d in responses if d.channel.startswith(f"{place}: ")):
            color = f"C{LAWS.index(d.channel.partition(': ')[2])}"
            for part, (ax, unit) in enumerate(
                zip(column, ("gain [dB]", "phase [deg]"), strict=True)
            ):
                ax.plot(d.before[0], d.before[1][:, part], color=color, lw=4, alpha=0.3)
                ax.plot(d.after[0], d.after[1][:, part], color=color, lw=0.9)
                ax.set_title(f"{place}, {unit}", fontsize=8)
        for ax in column:
            frequency_axis(ax.xaxis)
        column[0].set_xlabel("")
    for law, color in zip(LAWS, ("C0", "C1", "C2", "C3"), strict=True):
        axes[0, 0].plot([], [], color=color, lw=0.9, label=law)
    page.legend(loc="outside lower center", ncols=len(LAWS), fontsize=8)
    for d, ax in zip(shown, axes[2:].flat, strict=False):
        chosen = 0
        if d.before[1].shape == d.after[1].shape:
            by = np.abs(d.before[1] - d.after[1]) if d.share else np.abs(d.after[1] - d.after[1][0])
            chosen = int(by.max(axis=0).argmax())
        for (time, values), width, color in ((d.before, 4, "#9ecae1"), (d.after, 0.8, "#08306b")):
            if time.size:
                ax.plot(time, values[:, chosen], lw=width, color=color)
        color = "#a50f15" if d.share > TOLERANCE else "black"
        ax.set_title(f"{d.case}\n{d.channel}, {100.0 * d.share:.2g} %", fontsize=7, color=color)
    for ax in axes.flat:
        ax.tick_params(labelsize=7)
        ax.set_visible(bool(ax.lines))
    page.suptitle(f"{base} (broad) and this release (thin); time in s, values in SI", fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    page.savefig(path, dpi=75)
    plt.close(page)


def text(found: list[Difference], base: str, picture: str) -> str:
    """The page."""
    lines = [
        "# Since the last release",
        f"Which responses differ from those of {base}, and why? Made by "
        "`python scripts/compare_releases.py`: each case runs with both, and what differs by more "
        f"than {100.0 * TOLERANCE:g} % of what a channel spans in its case has its reason here.",
        f"![Responses of both releases]({picture})",
    ]
    table = ["| case | largest difference | of the channel | why |", "| --- | --- | --- | --- |"]
    same: list[str] = []
    for case in dict.fromkeys(d.case for d in found):
        mine = [d for d in found if d.case == case]
        apart = [d for d in mine if d.share > TOLERANCE]
        worst = max(mine, key=lambda d: d.share)
        if worst.share == 0.0:
            same.append(case)
            continue
        why = " ".join(dict.fromkeys(d.why or "**not explained**" for d in apart))
        table.append(f"| {case} | {100.0 * worst.share:.2g} % | {worst.channel} | {why} |")
    table.append(f"| all others, {len(same)} | none | | |")
    lines += [
        "<!-- table: release -->",
        "\n".join(table),
        "<!-- end -->",
        "Read next: [contributing](contributing.md).",
    ]
    return "\n\n".join(lines) + "\n"


def main() -> int:
    """Run both, draw the page, and name what nobody has explained."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("base", help="tag or commit of the last release")
    parser.add_argument("--out", type=Path, default=Path("out/behaviour"), help="where both run")
    parser.add_argument("--page", type=Path, default=Path("out/behaviour/release.md"))
    parser.add_argument("--picture", type=Path, help="default: beside the page")
    parser.add_argument("--only", help="names of cases, comma-separated")
    options = parser.parse_args()
    folders: list[Path] = []
    cases: list[str] = []
    for root in (export(options.base, options.out), Path().resolve()):
        results = (
            options.out / "results" / ("working_tree" if root == Path().resolve() else root.name)
        )
        program = RESPONSES.replace("OUT", str(results / "responses"))
        runs = {"responses": ["-c", program], **runs_of(root, results, comparison=False)}
        cases = options.only.split(",") if options.only else list(runs)
        for name in cases:
            run_case(root, results / name, runs[name])
        folders.append(results)
    found = [d for case in cases for d in differences(case, *folders)]
    changes = [
        change
        for change in tomllib.loads(EXPLAINED.read_text(encoding="utf-8"))["change"]
        if change["base"] == options.base
    ]
    found, unused = explain(found, changes)
    picture = options.picture or options.page.with_suffix(".png")
    figure(found, options.base, picture)
    place = Path("..", *picture.parts[1:]) if options.picture else Path(picture.name)
    options.page.write_text(text(found, options.base, place.as_posix()), encoding="utf-8")
    open_ = [d for d in found if d.share > TOLERANCE and not d.why]
    for d in open_:
        print(f"{d.case}: {d.channel} differs by {100.0 * d.share:.3g} %, not explained")
    for number in unused if not options.only else ():
        print(f"explains nothing: {changes[number]}")
    print(f"{len(found)} responses, {sum(d.share > TOLERANCE for d in found)} differ")
    return 1 if open_ or (unused and not options.only) else 0


if __name__ == "__main__":
    sys.exit(main())
