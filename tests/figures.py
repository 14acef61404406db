"""What a figure must do, whatever it shows: name its axes, and have its curves in view."""

import re
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Text


def curves(axes: Axes) -> list[tuple[Any, Any]]:
    """Points of every line with more than two, without guides drawn across the axes."""
    lines = [line for line in axes.lines if line.get_transform() == axes.transData]
    points = [np.asarray(line.get_xydata(), dtype=float).T for line in lines]
    return [(x, y) for x, y in points if x.size > 2]


def in_view(axes: Axes, x: Any, y: Any) -> float:
    """Share of the points between the ends of the abscissa that the ordinate holds."""
    (left, right), (low, high) = sorted(axes.get_xlim()), sorted(axes.get_ylim())
    across = y[(x >= left) & (x <= right) & np.isfinite(y)]
    return float(np.mean((across >= low) & (across <= high))) if across.size else 0.0


QUANTITIES = re.compile(
    r"acceleration|bandwidth|compensator|correlation|damping|demand|deviation|energy|engines|error|"
    r"excursion|force|frames|frequency|function|gain|leg|machine|mass|mode|motion|moved|overshoot|"
    r"phase|poles|poses|position|pressure|response|shares|sine|stability|stable|step|sweep|valve",
    re.IGNORECASE,
)
"""Words of which a title has one: what is drawn, not only of what."""


def check_title(figure: Figure, name: str) -> None:
    """A title says which quantity is drawn."""
    titles = [figure.get_suptitle(), *(axes.get_title() for axes in figure.axes)]
    assert QUANTITIES.search(" ".join(titles)), f"{name}: no quantity in its titles {titles}"


def check_readable(figure: Figure, name: str) -> None:
    """Every axes says what it shows; some curve of each lies mostly within its limits."""
    drawn = [axes for axes in figure.axes if axes.axison and axes.has_data()]
    assert drawn, f"{name}: holds no data"
    for axes in drawn:
        where = f"{name}: axes at {axes.get_position().bounds}"
        siblings = axes.get_shared_y_axes().get_siblings(axes)
        named = [sibling.get_ylabel() for sibling in siblings] + [figure.get_supylabel()]
        assert any(named) or axes.get_title() or axes.get_xlabel(), (
            f"{where}: nothing says what it shows"
        )
        shown = [in_view(axes, x, y) for x, y in curves(axes)]
        assert not shown or max(shown) > 0.5, f"{where}: curves lie outside, shares {shown}"
        check_decades(axes, where)
    labels = [axes.get_xlabel() for axes in drawn] + [figure.get_supxlabel()]
    assert any(labels), f"{name}: no abscissa has a name"
    check_texts(figure, name)
    check_legends(figure, name)


def check_decades(axes: Axes, where: str) -> None:
    """An axis of frequency is logarithmic, with ticks 1, 2, 5 of decades as plain numbers."""
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_label_text().startswith("frequency [") and axes.get_label() != "<colorbar>":
            assert axis.get_scale() == "log", f"{where}: frequency is not logarithmic"
            low, high = axis.get_view_interval()
            for tick in axis.get_majorticklocs():
                assert f"{tick:.0e}"[0] in "125", f"{where}: a tick at {tick}"
                if low <= tick <= high:
                    assert axis.get_major_formatter()(tick, 0) == f"{tick:g}"


def check_texts(figure: Figure, name: str) -> None:
    """No text is under 9 px high where the picture is 1280 px wide; zero has no minus sign."""
    shown = [t for t in figure.findobj(Text) if t.get_visible() and t.get_text()]
    pixels = 1280.0 / 72.0 / figure.get_figwidth()
    for text in shown:
        assert text.get_fontsize() * pixels > 8.99, f"{name}: {text.get_text()!r} is too small"
        assert not re.search(r"(?<![\w.])[-\u2212]0(\.0*)?(?![\d.])", text.get_text()), text


def check_legends(figure: Figure, name: str) -> None:
    """A legend lies on no curve."""
    boxes = [each.get_window_extent() for each in figure.findobj(Legend)]
    for axes in figure.axes:
        for x, y in curves(axes):
            inside = axes.bbox.padded(0.5)
            points = [
                p for p in axes.transData.transform(np.transpose([x, y])) if inside.contains(*p)
            ]
            for box in boxes:
                assert not any(box.contains(*point) for point in points), (
                    f"{name}: legend on a curve"
                )
