"""Tables, the figure and files of the objective motion cueing test (OMCT)."""

import math
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.typing import NDArray

from cmf_mj.core.result import Table, number
from cmf_mj.core.units import DEGREE, STANDARD_GRAVITY
from cmf_mj.pilot.omct import STAGES, TESTS, Omct
from cmf_mj.show import look

_GRAVITY_PER_DEG = STANDARD_GRAVITY * DEGREE  #: Specific force of a small tilt [m/s^2/deg].
_OMCT_CAPTION = (
    "modulus and phase [deg] from the aircraft's pilot to the simulator's; washout: host frames; "
    "ideal: behind the DCU, machine ideal; laws: at the crew's accelerometer of the machine. Cross "
    f"tests: m/s^2 per deg (the aircraft itself: {_GRAVITY_PER_DEG:.3f}) and deg per m/s^2 (the "
    "aircraft: 0). No boundary of acceptance is known."
)

SHARE_TOP = 2.0 * np.pi + 0.1
"""Highest frequency of `share_table` [rad/s]: the test's 6.31, which is 1 Hz, and a margin."""
_ROTATIONS = ("roll", "pitch", "yaw")
_TESTS_A_ROW = 2  #: In the figure.


def _modulus_unit(driven: str, output: str) -> tuple[str, float]:
    """Unit of a test's modulus, and its value in SI."""
    if (driven in _ROTATIONS) == (output in _ROTATIONS):
        return "", 1.0
    return ("m/s^2/deg", 1.0 / DEGREE) if driven in _ROTATIONS else ("deg/(m/s^2)", DEGREE)


def _phase_deg(response: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Phase [deg] unwrapped along the frequencies that have a response, (K,)."""
    known, angle = np.isfinite(response), np.full(response.shape, np.nan)
    angle[known] = np.degrees(np.unwrap(np.angle(response[known])))
    return angle


def omct_table(result: Omct) -> Table:
    """Modulus and phase of each test and stage over the frequencies."""
    rows: list[list[str]] = []
    first_stage, second_stage = STAGES
    for index, (driven, output) in enumerate(TESTS):
        unit, scale = _modulus_unit(driven, output)
        titles = {first_stage: f"{driven} > {output}", second_stage: unit}
        for stage, responses in result.responses.items():
            response = responses[index]
            if not np.isfinite(response).any():
                continue
            moduli = (number(modulus, ".3f") for modulus in np.abs(response) / scale)
            phases = (number(phase, ".0f") for phase in _phase_deg(response))
            rows.append([titles.get(stage, ""), stage, "mod", *moduli])
            rows.append(["", "", "deg", *phases])
    title = f"OMCT: washout {result.washout}, {result.cab} cab, {result.hydraulics} hydraulics"
    frequencies = [(f"{value:.3g}", "") for value in result.frequency]
    return Table(title, ("test", "", "rad/s", *frequencies), rows, _OMCT_CAPTION)


def share_table(result: Omct) -> Table:
    """One row per test, one column per law, of frequencies up to `SHARE_TOP`.

    A cell has the least to the largest modulus of machine over ideal machine, one number where both
    round alike, and the phase [deg] at the last frequency. It has a `*` if at any frequency the
    remainder exceeds the fundamental.
    """
    laws = [name for name in result.responses if name not in STAGES]
    is_low = result.frequency <= SHARE_TOP
    rows = []
    for index, (driven, output) in enumerate(TESTS):
        shares = {law: result.share(law)[index][is_low] for law in laws}
        if any(np.isfinite(share).any() for share in shares.values()):
            remainders = {law: result.remainder[law][index][is_low] for law in laws}
            cells = [_share_cell(shares[law], bool((remainders[law] > 1.0).any())) for law in laws]
            rows.append([f"{driven} > {output}", *cells])
    return Table("", ("test", *laws), rows)


def _share_cell(share: NDArray[np.complex128], remainder_dominates: bool) -> str:
    known = np.isfinite(share)
    if not known.any():
        return "-"
    moduli = np.abs(share[known])
    ends = (number(modulus, ".2f") for modulus in (moduli.min(), moduli.max()))
    modulus = " to ".join(dict.fromkeys(ends))
    last_phase = number(_phase_deg(share)[known][-1], ".0f")
    star = "*" if remainder_dominates else ""
    fault = "" if known.all() else ", left its bounds"
    return f"{modulus}, {last_phase}°{star}{fault}"


def omct_figure(result: Omct) -> Figure:
    """Modulus and phase over frequency of all tests that were made, two tests in a row."""
    is_tested = np.isfinite(np.array(list(result.responses.values()))).any(axis=(0, 2))
    tested = np.flatnonzero(is_tested).tolist()
    rows = math.ceil(len(tested) / _TESTS_A_ROW)
    columns = 2 * min(len(tested), _TESTS_A_ROW)  # modulus and phase of each
    figure = look.new_figure(3.25 * columns, 3.0 * rows + 0.6)
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False)
    for index, (modulus, phase) in zip(tested, panels.reshape(-1, 2), strict=False):
        _plot_test(modulus, phase, result, index)
    for panel in panels.flat:
        panel.grid(True, which="both")
        panel.set_visible(panel.has_data())
    for column in panels.T:
        *_, lowest = (panel for panel in column if panel.has_data())
        look.frequency_axis(lowest.xaxis, "rad/s")
        lowest.tick_params(labelbottom=True)
    look.legend(figure)
    figure.suptitle(
        "Modulus and phase from the aircraft's pilot to the simulator's: "
        f"washout {result.washout}, cab {result.cab}, {result.hydraulics} hydraulics"
    )
    return figure


def _plot_test(modulus: Axes, phase: Axes, result: Omct, index: int) -> None:
    """Draw modulus and phase of a test by its index in `TESTS`, a line a stage."""
    driven, output = TESTS[index]
    unit, scale = _modulus_unit(driven, output)
    colours = dict.fromkeys((look.GREY, look.BLACK, *look.COLOURS))  # each once
    for colour, (stage, responses) in zip(cycle(colours), result.responses.items(), strict=False):
        style: dict[str, Any] = {"color": colour, "label": stage}
        style |= {"linestyle": "--" if stage == "washout" else "-", "marker": ".", "lw": 1.2}
        modulus.plot(result.frequency, np.abs(responses[index]) / scale, **style)
        phase.plot(result.frequency, _phase_deg(responses[index]), **style)
    modulus.set(yscale="log")
    low, high = modulus.get_ylim()
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    modulus.yaxis.set_major_formatter(plain)
    modulus.yaxis.set_minor_formatter(plain if high < 10.0 * low else NullFormatter())
    if driven != output and driven in _ROTATIONS:
        modulus.axhline(_GRAVITY_PER_DEG, color=look.GREY, linestyle=":")
    ylabel = f"modulus [{unit}]" if unit else "modulus"
    modulus.set(title=f"{driven} > {output}", ylabel=ylabel)
    phase.set_ylabel("phase [deg]")


def save_omct(result: Omct, folder: Path) -> list[Path]:
    """Write `omct.csv` (modulus in SI, phases in deg), `omct.md`, `share.md` and `omct.png`."""
    rows = []
    for index, (driven, output) in enumerate(TESTS):
        for stage, responses in result.responses.items():
            share, response = result.share(stage)[index], responses[index]
            columns = {
                "frequency_rad_s": result.frequency,
                "modulus_si": np.abs(response),
                "phase_deg": _phase_deg(response),
                "remainder": result.remainder[stage][index],
                "share_modulus": np.abs(share),
                "share_phase_deg": _phase_deg(share),
            }
            test = {"test": f"{driven}>{output}", "stage": stage}
            for row in np.flatnonzero(np.isfinite(response)):
                rows.append(test | {name: values[row] for name, values in columns.items()})
    files = {
        "omct.csv": rows,
        "omct.md": omct_table(result),
        "share.md": share_table(result),
        "omct.png": omct_figure(result),
    }
    return look.save_files(files, folder, 70)
