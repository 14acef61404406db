"""What a figure must do, whatever it shows: name its axes, and have its curves in view."""

import re
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure


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
    labels = [axes.get_xlabel() for axes in drawn] + [figure.get_supxlabel()]
    assert any(labels), f"{name}: no abscissa has a name"
