"""A figure as data: panels of curves, drawn on a page and in films."""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

GREY = "#777777"
"""Of demands and references."""

Dash = Literal["solid", "dash", "dot"]

Marks = Literal["", "ring", "dot"]


class Curve(NamedTuple):
    """One line or set of marks; curves of one name share an entry of the legend."""

    name: str
    x: NDArray[np.floating]
    y: NDArray[np.floating]
    colour: str
    dash: Dash = "solid"
    marks: Marks = ""  #: Drawn in place of a line.
    width: float = 1.5
    pale: bool = False  #: Not to be relied on.


class Panel(NamedTuple):
    """One pair of axes; all panels of a figure have the x axis of the last."""

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
