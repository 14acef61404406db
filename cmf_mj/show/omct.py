"""Table, figure and files of the objective motion cueing test."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.typing import NDArray

from cmf_mj.core.table import Table, number
from cmf_mj.core.units import DEGREE, STANDARD_GRAVITY
from cmf_mj.pilot.omct import STAGES, TESTS, Omct
from cmf_mj.show.look import COLOURS, GREY, grid, new_figure, save_files

_LEGEND = (
    "modulus and phase [deg] from the aircraft's pilot to the simulator's; washout: host frames; "
    "ideal: behind the DCU, machine ideal; laws: at the crew's accelerometer of the machine. Cross "
    "tests: m/s^2 per deg (the aircraft itself: 0.171) and deg per m/s^2 (the aircraft: 0). No "
    "boundary of acceptance is known."
)

UP_TO = 2.0 * np.pi + 0.1
"""Highest frequency of the table of shares [rad/s]: 1 Hz, which is 6.31 rad/s of the test."""

_ROTATIONS = ("roll", "pitch", "yaw")


def unit(place: int) -> tuple[str, float]:
    """Unit of a test's modulus and what one of it is in SI."""
    driven, output = TESTS[place]
    if (driven in _ROTATIONS) == (output in _ROTATIONS):
        return "", 1.0
    return ("m/s^2/deg", 1.0 / DEGREE) if driven in _ROTATIONS else ("deg/(m/s^2)", DEGREE)


def title(stage: str) -> str:
    """A stage or law as tables and figures call it."""
    return "ideal" if stage == "demand" else stage


def phase(response: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Phase [deg] unwrapped along the frequencies that have a response, (K,)."""
    known, angle = np.isfinite(response), np.full(response.shape, np.nan)
    angle[known] = np.degrees(np.unwrap(np.angle(response[known])))
    return angle


def omct_table(result: Omct) -> Table:
    """Modulus and phase of each test and stage over the frequencies."""
    rows: list[list[str]] = []
    rules = []
    for place, (driven, output) in enumerate(TESTS):
        name, scale = unit(place)
        for stage, responses in result.responses.items():
            row = responses[place]
            if not np.isfinite(row).any():
                continue
            test = name if stage == "demand" else ""
            if stage == STAGES[0]:
                test = f"{driven} > {output}"
                rules.append(len(rows))
            sizes = (_text(size, 3) for size in np.abs(row) / scale)
            rows.append([test, title(stage), "mod", *sizes])
            rows.append(["", "", "deg", *(_text(angle, 0) for angle in phase(row))])
    about = f"OMCT: washout {result.washout}, {result.cab} cab, {result.hydraulics} hydraulics"
    frequencies = [(f"{value:.3g}", "") for value in result.frequency]
    return Table(about, ("test", "", "rad/s", *frequencies), rows, _LEGEND, rules=rules)


def share_table(result: Omct) -> Table:
    """A row a test: the share of each law up to `UP_TO`.

    A cell holds least and largest modulus of machine over ideal, or one where they round alike, and
    the phase [deg] at the last frequency; `*` where anywhere the output has more outside the
    fundamental than in it.
    """
    laws = [name for name in result.responses if name not in STAGES]
    low = result.frequency <= UP_TO
    rows = []
    for place, (driven, output) in enumerate(TESTS):
        shares = [result.share(law)[place][low] for law in laws]
        if any(np.isfinite(share).any() for share in shares):
            cells = [
                _range(share, bool((result.remainder[law][place][low] > 1.0).any()))
                for law, share in zip(laws, shares, strict=True)
            ]
            rows.append([f"{driven} > {output}", *cells])
    return Table("", ("test", *laws), rows)


def _range(share: NDArray[np.complex128], impure: bool) -> str:
    known = np.isfinite(share)
    if not known.any():
        return "-"
    sizes = np.abs(share[known])
    size = " to ".join(dict.fromkeys(_text(value, 2) for value in (sizes.min(), sizes.max())))
    lost = "" if known.all() else ", left its bounds"
    return f"{size}, {_text(phase(share)[known][-1], 0)}°{'*' if impure else ''}{lost}"


def _text(value: float, digits: int) -> str:
    return number(round(value, digits) + 0.0, f".{digits}f")  # no -0


def omct_figure(result: Omct) -> Figure:
    """Modulus and phase of all tests over frequency."""
    figure = new_figure(13.0, 15.0)
    axes = figure.subplots(5, 4, sharex=True)
    colours = ("#999999", "#000000", *(colour for colour in COLOURS if colour != "#000000"))
    for place, (driven, output) in enumerate(TESTS):
        row, side = divmod(place, 2)
        modulus, angle = axes[row, 2 * side], axes[row, 2 * side + 1]
        name, scale = unit(place)
        for index, (stage, responses) in enumerate(result.responses.items()):
            style: dict[str, Any] = {"color": colours[index % len(colours)], "label": title(stage)}
            style |= {"linestyle": "--" if stage == "washout" else "-", "marker": ".", "lw": 1.2}
            modulus.plot(result.frequency, np.abs(responses[place]) / scale, **style)
            angle.plot(result.frequency, phase(responses[place]), **style)
        if any(np.isfinite(responses[place]).any() for responses in result.responses.values()):
            modulus.set(xscale="log", yscale="log")
            low, high = modulus.get_ylim()
            plain = FuncFormatter(lambda value, _: f"{value:g}")
            modulus.yaxis.set_major_formatter(plain)
            modulus.yaxis.set_minor_formatter(plain if high < 10.0 * low else NullFormatter())
        if driven != output and driven in _ROTATIONS:
            modulus.axhline(STANDARD_GRAVITY * DEGREE, color=GREY, linestyle=":", linewidth=1.0)
        modulus.set_title(f"{driven} > {output}", fontsize=10)
        modulus.set_ylabel(f"modulus [{name}]" if name else "modulus", fontsize=9)
        angle.set_ylabel("phase [deg]", fontsize=9)
    grid(*axes.flat, which="both")
    for axis in axes.flat:
        axis.tick_params(which="both", labelsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("frequency [rad/s]", fontsize=9)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=9)
    figure.suptitle(
        "Modulus and phase from the aircraft's pilot to the simulator's: "
        f"washout {result.washout}, cab {result.cab}, {result.hydraulics} hydraulics"
    )
    return figure


def save_omct(result: Omct, folder: Path) -> list[Path]:
    """Write `omct.csv` (SI), `omct.md`, `share.md` (laws over an ideal machine) and `omct.png`."""
    header = ["test", "stage", "frequency_rad_s", "modulus_si", "phase_deg", "remainder"]
    files = {
        "omct.csv": ([*header, "share_modulus", "share_phase_deg"], _rows(result)),
        "omct.md": omct_table(result).save,
        "share.md": share_table(result).save,
        "omct.png": omct_figure(result),
    }
    return save_files(files, folder, 70)


def _rows(result: Omct) -> Iterator[list[str]]:
    for place, (driven, output) in enumerate(TESTS):
        for stage, responses in result.responses.items():
            share, response = result.share(stage)[place], responses[place]
            columns = (
                *(np.abs(response), phase(response), result.remainder[stage][place]),
                *(np.abs(share), phase(share)),
            )
            for frequency, values in zip(result.frequency, zip(*columns, strict=True), strict=True):
                if np.isfinite(values[0]):
                    where = [f"{driven}>{output}", title(stage), f"{frequency:.6g}"]
                    yield [*where, *(f"{value:.6g}" for value in values)]
