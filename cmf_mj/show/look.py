"""How every figure looks: palette, grid, Bode axes, panels; and how contents become files."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from cycler import cycler
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import LogLocator, MultipleLocator, NullLocator
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import FrequencyResponse
from cmf_mj.analysis.measurable import LEAST_COHERENCE
from cmf_mj.analysis.published import Published
from cmf_mj.core.errors import check_name
from cmf_mj.core.files import plain_path, whole_file, write_json
from cmf_mj.core.tables import write_csv

BLUE, ORANGE, GREEN, PURPLE, AMBER, SKY, BLACK = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000",
)  # fmt: skip
COLOURS = (BLUE, ORANGE, GREEN, PURPLE, AMBER, SKY, BLACK, "#999933")
"""Distinct to readers with any colour vision (Okabe and Ito), in order of use."""
FAINT = 0.3  #: Opacity of pale curves.
DARK, GREY, PALE = "0.2", "0.6", "0.9"  #: Colours of limits, of references, and of grids.

STYLE: dict[str, Any] = {
    "axes.prop_cycle": cycler(color=COLOURS),
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 10,
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "grid.color": PALE,
    "grid.linewidth": 0.6,
}
"""Style of all axes."""

FORMATS = ("png", "svg", "pdf")  #: Of the files of figures.
_SMALLEST_TEXT = 9.0 * 72.0 / 1280.0  #: 9 px of 1280 px across, for a figure 1 in wide [points].

_FORMAT: ContextVar[str | None] = ContextVar("format", default=None)
"""Format of all figures that are written; None as the name of each ends."""


@contextmanager
def write_figures_as(form: str | None = None) -> Iterator[None]:
    """Write all figures in a format: png, svg or pdf."""
    check_name("figure_format", form or "png", FORMATS)
    token = _FORMAT.set(form)
    try:
        yield
    finally:
        _FORMAT.reset(token)


class _Figure(Figure):
    """A figure whose axes have a style."""

    style = STYLE

    def add_subplot(self, *args: Any, **options: Any) -> Axes:
        with rc_context(self.style):  # type: ignore[arg-type]
            return super().add_subplot(*args, **options)


def new_figure(width: float, height: float, *, gridded: bool = True) -> Figure:
    """An empty figure [in] whose axes and labels do not overlap; `gridded` but for images."""
    figure = _Figure(figsize=(width, height), layout="constrained")
    figure.style = STYLE | {"axes.grid": gridded}
    return figure


def stack(
    width: float,
    height: float,
    *labels: str,
    x: str = "time [s]",
    ratios: Sequence[float] | None = None,
) -> tuple[Figure, list[Axes]]:
    """A figure of axes above each other, one for each label of y, all over the same `x`."""
    figure = new_figure(width, height)
    options: dict[str, Any] = {"sharex": True, "squeeze": False, "height_ratios": ratios}
    rows = list(figure.subplots(len(labels), 1, **options)[:, 0])
    for axes, label in zip(rows, labels, strict=True):
        axes.set_ylabel(label)
    rows[-1].set_xlabel(x)
    return figure, rows


def shade(axes: Axes, time: NDArray[np.float64], where: NDArray[np.bool_]) -> None:
    """Shade the stretches of time `where` a condition is true."""
    full_height = axes.get_xaxis_transform()
    style: dict[str, Any] = {"color": ORANGE, "alpha": 0.2, "transform": full_height}
    axes.fill_between(time, 0.0, 1.0, where=where.tolist(), **style)


def legend(*targets: Axes | Figure, **options: Any) -> None:
    """A small legend beside each of the axes; or below all axes of a figure, a name once."""
    for target in targets:
        layout: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5)}
        if isinstance(target, Figure):
            layout = _figure_legend(target, options.pop("handles", ()))
        target.legend(**{"fontsize": 8, "frameon": False, **layout, **options})


def _figure_legend(figure: Figure, handles: Iterable[Any]) -> dict[str, Any]:
    """Entries of the legend below a figure, and in how many columns they fit its width."""
    entries: dict[str, Any] = {}
    for axes in figure.axes:
        lines, names = axes.get_legend_handles_labels()
        entries |= dict(zip(names, lines, strict=True))
    entries |= {handle.get_label(): handle for handle in handles}
    entry_width = (4.0 + 0.6 * max(map(len, entries), default=1)) * 8.0 / 72.0
    row_count = np.ceil(len(entries) / max(figure.get_figwidth() // entry_width, 1.0))
    return {
        "loc": "outside lower center",
        "handles": list(entries.values()),
        "labels": list(entries),
        "ncols": int(np.ceil(len(entries) / max(row_count, 1.0))),
    }


def frequency_axis(axis: Axis, unit: str = "Hz") -> None:
    """A logarithmic axis of frequency with ticks 0.5, 1, 2, 5, 10, and its name."""
    axis.axes.set(**{f"{axis.axis_name}scale": "log"})  # type: ignore[attr-defined]
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())
    axis.set_label_text(f"frequency [{unit}]")


def style_bode(gain: Axes, phase: Axes, title: str = "", *, limits: bool = False) -> None:
    """Labels and grid of a pair of Bode axes; `limits` draws the -3 dB and -90 deg lines."""
    gain.set(ylabel="gain [dB]", title=title)
    phase.set(ylabel="phase [deg]")
    frequency_axis(phase.xaxis)
    phase.yaxis.set_major_locator(MultipleLocator(45.0))
    if limits:
        gain.axhline(-3.0, color=GREY, linewidth=0.8)
        phase.axhline(-90.0, color=GREY, linewidth=0.8)


def bode_axes(title: str = "", *, limits: bool = False) -> tuple[Figure, Axes, Axes]:
    """A figure with axes of gain and phase; `limits` draws the -3 dB and -90 deg lines."""
    figure = new_figure(8.0, 7.0)
    gain, phase = figure.subplots(2, 1, sharex=True)
    style_bode(gain, phase, title, limits=limits)
    return figure, gain, phase


def plot_bode(
    gain: Axes, phase: Axes, response: FrequencyResponse, *, stable: bool = True, **style: Any
) -> Any:
    """Draw a response and return its colour.

    It is pale where its coherence is below `LEAST_COHERENCE`, all of it where not `stable`.
    """
    is_clear = ~(response.coherence < LEAST_COHERENCE) | (not stable)
    opacity = 1.0 if stable else FAINT
    for axes, values in ((gain, response.gain_db), (phase, response.phase_deg)):
        clear_values = np.where(is_clear, values, np.nan)
        (line,) = axes.plot(response.frequency, clear_values, alpha=opacity, **style)
        style |= {"color": line.get_color(), "label": None}
        if not is_clear.all():
            axes.plot(response.frequency, values, alpha=FAINT, **style)
    return style["color"]


def bode_figure(
    title: str,
    curves: Mapping[str, FrequencyResponse],
    *,
    stable: bool = True,
    limits: bool = False,
    bounds: bool = False,
) -> tuple[Figure, Axes, Axes]:
    """A figure with axes of gain and phase: responses by name, with `bounds` their 95 % circles."""
    figure, gain, phase = bode_axes(title, limits=limits)
    line_styles = cycle(("-", "--"))  # since neighbours may coincide
    for (name, response), line in zip(curves.items(), line_styles, strict=False):
        colour = plot_bode(gain, phase, response, stable=stable, label=name, linestyle=line)
        if bounds:
            plot_bound(gain, phase, response, color=colour)
    legend(figure)
    return figure, gain, phase


def plot_published(gain: Axes, phase: Axes, published: Published, colour: str) -> bool:
    """Draw published bandwidths as circles; true if there are any."""
    gain_hz, phase_hz = published.gain_bandwidth_hz, published.phase_bandwidth_hz
    for axes, hertz, level in ((gain, gain_hz, -3.0), (phase, phase_hz, -90.0)):
        if hertz is not None:
            axes.plot(hertz, level, "o", color=colour, fillstyle="none")
    return bool(gain_hz or phase_hz)


def plot_bound(gain: Axes, phase: Axes, response: FrequencyResponse, **style: Any) -> None:
    """Shade the gains and phases within the circles of 95 % about a response's lines."""
    share = np.minimum(response.bound / np.abs(response.response), 0.99)
    gain_change = 20.0 * np.log10(np.clip([1.0 - share, 1.0 + share], 1e-3, None))
    angle = np.degrees(np.arcsin(share))
    for axes, values, (low, high) in (
        (gain, response.gain_db, gain_change),
        (phase, response.phase_deg, (-angle, angle)),
    ):
        axes.fill_between(response.frequency, values + low, values + high, alpha=0.25, **style)


def _make_readable(figure: Figure) -> None:
    """Give every text of a figure at least the smallest size, and wrap its titles."""
    smallest = _SMALLEST_TEXT * float(figure.get_figwidth())
    for text in figure.findobj(Text):
        text.set_fontsize(max(float(text.get_fontsize()), smallest))
    for title in figure.texts:
        title.set_wrap(True)
    for axis in _axes_of(figure):
        for label in axis.get_ticklabels()[:1]:  # labels that are yet to be made are like it
            axis.set_tick_params(which="both", labelsize=label.get_fontsize())


def _axes_of(figure: Figure) -> list[Axis]:
    """The x and y axes of a figure."""
    return [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]


def save_figure(figure: Figure, path: Path, dpi: int = 110) -> Path:
    """Write a figure by the ending of the name and release its memory.

    `write_figures_as` changes the ending. The file appears when it is complete, and the same figure
    gives the same bits: no date, no names of programs. Folders are made.
    """
    form = _FORMAT.get()
    path = path if form is None else path.with_suffix(f".{form}")
    kind = path.suffix.removeprefix(".")
    _make_readable(figure)
    for text in figure.findobj(Text):
        text.set_parse_math(False)  # a title with $ signs is no formula
    for axis in _axes_of(figure):
        for text in (axis.get_offset_text(), *axis.get_ticklabels(which="both")):
            text.set_parse_math(True)  # but powers of ten at the ticks are
    metadata = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with whole_file(path) as partial, rc_context({"svg.hashsalt": path.stem}):
        figure.savefig(partial, dpi=dpi, format=kind, metadata=metadata.get(kind))
    figure.clear()
    return path


def plain_data(value: Any) -> Any:
    """JSON values: tuples with names as tables, complex numbers as pairs, None for NaN.

    >>> plain_data({"poles": np.array([1j]), "misfit": np.nan})
    {'poles': [[0.0, 1.0]], 'misfit': None}
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, complex):
        value = [value.real, value.imag]
    if isinstance(value, Mapping) or hasattr(value, "_asdict"):
        table = value if isinstance(value, Mapping) else value._asdict()
        return {str(name): plain_data(entry) for name, entry in table.items()}
    if isinstance(value, list | tuple):
        return [plain_data(entry) for entry in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def save_files(files: Mapping[str, Any], folder: Path, dpi: int = 110) -> list[Path]:
    """Write contents to a folder under the names of their files.

    A content is a figure; a mapping, for JSON as it is and for CSV by column; a list of rows by
    name for CSV; an object with `save`, such as a table or a record; or a function of the path.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, content in files.items():
        path = plain_path(folder, name)
        if isinstance(content, Figure):
            path = save_figure(content, path, dpi)
        elif isinstance(content, list):
            write_csv(path, content[0].keys(), (row.values() for row in content))
        elif isinstance(content, Mapping) and path.suffix == ".csv":
            write_csv(path, content, zip(*content.values(), strict=True))
        elif isinstance(content, Mapping):
            write_json(path, plain_data(content))
        else:
            getattr(content, "save", content)(path)
        paths.append(path)
    return paths


class Curve(NamedTuple):
    """One line of a panel; curves of one name share an entry of the legend."""

    name: str
    x: NDArray[np.floating]
    y: NDArray[np.floating]
    colour: str
    width: float = 1.5


class Panel(NamedTuple):
    """One pair of axes."""

    y_title: str
    curves: tuple[Curve, ...]
    from_zero: bool = False  #: Whether the y axis of a page has zero at its lower end.


def plot_panel(axes: Axes, panel: Panel) -> None:
    """Draw the lines of a panel, and name its y axis."""
    for curve in panel.curves:
        axes.plot(curve.x, curve.y, label=curve.name, color=curve.colour, linewidth=curve.width)
    axes.set_ylabel(panel.y_title)
