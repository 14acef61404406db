"""Table, figure and files of the objective motion cueing test."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cmf_mj.core.files import write_csv, write_text
from cmf_mj.core.units import DEGREE, STANDARD_GRAVITY
from cmf_mj.pilot.omct import STAGES, TESTS, Omct
from cmf_mj.show.comparison import markdown

LEGEND = (
    "modulus and phase [deg] from the aircraft's pilot to the simulator's; washout: host frames; "
    "ideal: behind the DCU, machine ideal; laws: at the crew's accelerometer of the machine. Cross "
    "tests: m/s^2 per deg (the aircraft itself: 0.171) and deg per m/s^2 (the aircraft: 0). No "
    "boundary of acceptance is known."
)
"""What the numbers mean."""

_HEADER = (
    *("test", "stage", "frequency_rad_s", "modulus_si", "phase_deg"),
    *("remainder", "share_modulus", "share_phase_deg"),
)

UP_TO = 2.0 * np.pi + 0.1
"""Highest frequency of the table of shares [rad/s]: 1 Hz, which is 6.31 rad/s of the test."""

_ROTATIONS = ("roll", "pitch", "yaw")
_COLOURS = ("#999999", "#000000", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")


def unit(place: int) -> tuple[str, float]:
    """Unit of a test's modulus and what one of it is in SI."""
    given, output = TESTS[place]
    if (given in _ROTATIONS) == (output in _ROTATIONS):
        return "", 1.0
    if given in _ROTATIONS:
        return "m/s^2/deg", 1.0 / DEGREE
    return "deg/(m/s^2)", DEGREE


def title(stage: str) -> str:
    """A stage or law as tables and figures call it."""
    return {"washout": "washout", "demand": "ideal"}.get(stage, stage)


def phase(response: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Phase [deg] unwrapped along the frequencies that have a response, (K,)."""
    known = np.isfinite(response)
    found = np.full(response.shape, np.nan)
    found[known] = np.degrees(np.unwrap(np.angle(response[known])))
    return found


def omct_cells(result: Omct) -> tuple[list[str], list[list[str]]]:
    """Header and lines: modulus and phase of each test and stage over the frequencies."""
    header = ["test", "", "rad/s", *(f"{value:.3g}" for value in result.frequency)]
    lines = []
    for place, (given, output) in enumerate(TESTS):
        name, scale = unit(place)
        for stage, responses in result.responses.items():
            row = responses[place]
            if not np.isfinite(row).any():
                continue
            test = (
                f"{given} > {output}" if stage == STAGES[0] else name if stage == "demand" else ""
            )
            sizes, angles = np.abs(row) / scale, phase(row)
            lines.append([test, title(stage), "mod", *(_cell(size, 3) for size in sizes)])
            lines.append(["", "", "deg", *(_cell(angle, 0) for angle in angles)])
    return header, lines


def share_cells(result: Omct) -> tuple[list[str], list[list[str]]]:
    """Header and a line a test: the share of each law up to `UP_TO`.

    A cell holds least and largest modulus of machine over ideal, or one where they round alike, and
    the phase [deg] at the last frequency; `*` where anywhere the output has more beside the
    fundamental than in it.
    """
    laws = [name for name in result.responses if name not in STAGES]
    low = result.frequency <= UP_TO
    lines = []
    for place, (given, output) in enumerate(TESTS):
        shares = [result.share(law)[place][low] for law in laws]
        if any(np.isfinite(share).any() for share in shares):
            cells = [
                _range(share, bool((result.remainder[law][place][low] > 1.0).any()))
                for law, share in zip(laws, shares, strict=True)
            ]
            lines.append([f"{given} > {output}", *cells])
    return ["test", *laws], lines


def _range(share: NDArray[np.complex128], beside: bool) -> str:
    known = np.isfinite(share)
    if not known.any():
        return "-"
    sizes = [_cell(value, 2) for value in (np.abs(share[known]).min(), np.abs(share[known]).max())]
    size = sizes[0] if sizes[0] == sizes[1] else " to ".join(sizes)
    lost = "" if known.all() else ", left its bounds"
    return f"{size}, {_cell(phase(share)[known][-1], 0)}°{'*' if beside else ''}{lost}"


def _cell(value: float, digits: int) -> str:
    return "-" if np.isnan(value) else f"{round(value, digits) + 0.0:.{digits}f}"  # no -0


def omct_table(result: Omct) -> Table:
    """The tests as a terminal table."""
    table = Table(
        title=f"OMCT: washout {result.washout}, {result.cab} cab, {result.hydraulics} hydraulics",
        caption=LEGEND,
        caption_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    header, lines = omct_cells(result)
    for index, name in enumerate(header):
        table.add_column(name, justify="left" if index < 3 else "right", no_wrap=True)
    for number, line in enumerate(lines):
        if number and ">" in line[0]:
            table.add_section()
        table.add_row(*line)
    return table


def omct_figure(result: Omct) -> Figure:
    """Modulus and phase of all tests over frequency."""
    figure = Figure(figsize=(13.0, 15.0), layout="constrained")
    axes = figure.subplots(5, 4, sharex=True)
    for place, (given, output) in enumerate(TESTS):
        row, side = divmod(place, 2)
        modulus, angle = axes[row, 2 * side], axes[row, 2 * side + 1]
        name, scale = unit(place)
        known = False
        for index, (stage, responses) in enumerate(result.responses.items()):
            values = responses[place]
            style = {
                "color": _COLOURS[index % len(_COLOURS)],
                "linestyle": "--" if stage == "washout" else "-",
                "marker": "o",
                "markersize": 3.0,
                "linewidth": 1.2,
                "label": title(stage),
            }
            known = known or bool(np.isfinite(values).any())
            modulus.plot(result.frequency, np.abs(values) / scale, **style)
            angle.plot(result.frequency, phase(values), **style)
        if known:
            modulus.set(xscale="log", yscale="log")
            low, high = modulus.get_ylim()
            plain = FuncFormatter(lambda value, _: f"{value:g}")
            modulus.yaxis.set_major_formatter(plain)
            modulus.yaxis.set_minor_formatter(plain if high < 10.0 * low else NullFormatter())
        if given != output and given in _ROTATIONS:
            modulus.axhline(STANDARD_GRAVITY * DEGREE, color="0.5", linestyle=":", linewidth=1.0)
        modulus.set_title(f"{given} > {output}", fontsize=10)
        modulus.set_ylabel(f"modulus [{name}]" if name else "modulus", fontsize=9)
        angle.set_ylabel("phase [deg]", fontsize=9)
        for axis in (modulus, angle):
            axis.grid(True, which="both", color="0.9", linewidth=0.6)
            axis.tick_params(which="both", labelsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("frequency [rad/s]", fontsize=9)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=9)
    return figure


def save_omct(result: Omct, folder: Path) -> list[Path]:
    """Write `omct.csv` (SI), `omct.md`, `share.md` (laws over an ideal machine) and `omct.png`."""
    folder.mkdir(parents=True, exist_ok=True)
    write_csv(folder / "omct.csv", _HEADER, _rows(result))
    for name, cells in (("omct.md", omct_cells(result)), ("share.md", share_cells(result))):
        write_text(folder / name, markdown(*cells))
    omct_figure(result).savefig(folder / "omct.png", dpi=70)
    return [folder / name for name in ("omct.csv", "omct.md", "share.md", "omct.png")]


def _rows(result: Omct) -> Iterator[list[str]]:
    for place, (given, output) in enumerate(TESTS):
        for stage, responses in result.responses.items():
            share = result.share(stage)[place]
            columns = (
                np.abs(responses[place]),
                phase(responses[place]),
                result.remainder[stage][place],
                np.abs(share),
                phase(share),
            )
            for frequency, values in zip(result.frequency, zip(*columns, strict=True), strict=True):
                if np.isfinite(values[0]):
                    where = [f"{given}>{output}", title(stage), f"{frequency:.6g}"]
                    yield [*where, *(f"{value:.6g}" for value in values)]
