"""A figure as data: panels of curves, drawn alike on a page, in print and in films."""

from collections.abc import Iterable
from typing import Any, Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike, NDArray

GREY = "#777777"
"""Of demands and references."""

MOST = 1200
"""Largest number of points a curve keeps."""

Dash = Literal["solid", "dash", "dot"]
_DASHES = {"solid": "-", "dash": "--", "dot": ":"}


class Curve(NamedTuple):
    """One line or set of marks."""

    name: str
    x: NDArray[np.floating]
    y: NDArray[np.floating]
    colour: str
    dash: Dash = "solid"
    marks: bool = False  #: Marks without a line.
    width: float = 1.5


class Panel(NamedTuple):
    """One pair of axes; all panels of a chart have the x axis of the last."""

    y_title: str
    curves: tuple[Curve, ...]
    y_range: tuple[float, float] | None = None
    y_tick: float | None = None
    guides: tuple[float, ...] = ()  #: Horizontal lines.
    x_title: str = ""
    x_range: tuple[float, float] | None = None
    x_log: bool = False
    height: float = 1.0  #: Relative.
    from_zero: bool = False  #: Whether the y axis of a film has zero at its lower end.


class Chart(NamedTuple):
    """A figure and the words under it."""

    panels: tuple[Panel, ...]
    caption: str


def thinned(
    x: NDArray[np.float64], y: NDArray[np.float64], most: int = MOST
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """At most `most` points: of each of equal stretches the lowest and the highest.

    Peaks survive, as they would not if every n-th point were kept.
    """
    if x.size <= most:
        return x, y
    edges = np.linspace(0, x.size, most // 2 + 1).astype(int)
    kept: set[int] = {0, x.size - 1}
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        part = y[first:last]
        kept |= {first + int(np.argmin(part)), first + int(np.argmax(part))}
    chosen = np.array(sorted(kept)[:most])
    return x[chosen], y[chosen]


def curve(
    name: str,
    x: ArrayLike,
    y: ArrayLike,
    colour: str,
    dash: Dash = "solid",
    *,
    marks: bool = False,
    width: float = 1.5,
    within: tuple[float, float] | None = None,
) -> Curve:
    """A curve (N,) without what cannot be drawn, thinned, in single precision.

    Curves of one name share an entry of the legend; `within` is the part of x to keep.
    """
    across, up = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    drawn = np.isfinite(across) & np.isfinite(up)
    if within is not None:
        drawn &= (across >= within[0]) & (across <= within[1])
    across, up = thinned(across[drawn], up[drawn])
    return Curve(name, across.astype(np.float32), up.astype(np.float32), colour, dash, marks, width)


def plot_curves(axes: Axes, curves: Iterable[Curve], *, scale: float = 1.0) -> dict[str, Line2D]:
    """Draw curves; the first line of each name for a legend."""
    lines: dict[str, Line2D] = {}
    for one in curves:
        style: dict[str, Any] = {"linestyle": _DASHES[one.dash]}
        if one.marks:
            style = {"marker": "o", "linestyle": "", "fillstyle": "none", "markersize": 5}
        style |= {"color": one.colour, "linewidth": scale * one.width, "label": one.name}
        lines.setdefault(one.name, axes.plot(one.x, one.y, **style)[0])
    return lines
