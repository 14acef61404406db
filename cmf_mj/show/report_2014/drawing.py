"""Charts as plotly figures for the screen and as SVG pictures for print."""

import io
import math
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MultipleLocator, NullFormatter

from cmf_mj.core.errors import require
from cmf_mj.show.chart import Chart, Curve, plot_curves

_PANEL, _MARGIN = 230, 96
"""Height of a panel and of what surrounds all [px]."""


def chart_height(chart: Chart) -> int:
    """Height on the screen [px]."""
    return _MARGIN + round(sum(panel.height for panel in chart.panels) * _PANEL)


def _log_ticks(limits: tuple[float, float]) -> list[float]:
    """1, 2 and 5 of each decade within the limits."""
    low, high = math.floor(math.log10(limits[0])), math.ceil(math.log10(limits[1]))
    ticks = [float(f"{m}e{e}") for e in range(low, high + 1) for m in (1, 2, 5)]
    return [tick for tick in ticks if limits[0] <= tick <= limits[1]]


def _trace(line: Curve) -> dict[str, Any]:
    colour = {"color": line.colour}
    return {
        "name": line.name,
        "legendgroup": line.name,
        "x": line.x,
        "y": line.y,
        "mode": "markers" if line.marks else "lines",
        "line": {**colour, "width": line.width, "dash": line.dash, "simplify": False},
        "marker": {**colour, "size": 9, "symbol": "circle-open", "line": {"width": 2}},
        "hovertemplate": "%{x:.4g}, %{y:.4g}<extra>%{fullData.name}</extra>",
    }


def plotly_json(chart: Chart) -> str:
    """The chart as JSON of a plotly figure; the same bytes for the same chart."""
    panels = chart.panels
    figure = require("plotly.subplots", "report").make_subplots(
        rows=len(panels),
        shared_xaxes=True,
        row_heights=[panel.height for panel in panels],
        vertical_spacing=0.08 / len(panels),
    )
    names: set[str] = set()
    for row, panel in enumerate(panels, start=1):
        where = {"row": row, "col": 1}
        for line in panel.curves:
            figure.add_scatter(**_trace(line), showlegend=line.name not in names, **where)
            names.add(line.name)
        for level in panel.guides:
            figure.add_hline(level, line={"color": "#999999", "width": 1, "dash": "dot"}, **where)
        figure.update_yaxes(range=panel.y_range, dtick=panel.y_tick, title=panel.y_title, **where)
    limits, log = panels[-1].x_range, panels[-1].x_log
    figure.update_xaxes(type="log" if log else "linear", range=limits)
    if log and limits is not None:
        ends = [math.log10(value) for value in limits]
        figure.update_xaxes(range=ends, tickvals=_log_ticks(limits))
    title = {"text": panels[-1].x_title, "standoff": 6}
    figure.update_xaxes(title=title, row=len(panels), col=1)
    for update in (figure.update_xaxes, figure.update_yaxes):
        update(gridcolor="#e5e5e5", zeroline=False)
    figure.update_layout(
        template="none",
        height=chart_height(chart),
        margin={"l": 62, "r": 12, "t": 44, "b": 52},
        hovermode="closest",
        legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0.0},
        font={"family": "system-ui, sans-serif", "size": 12},
    )
    return str(figure.to_json())


def still(chart: Chart) -> str:
    """The chart as an SVG picture, texts as outlines; the same bytes for the same chart."""
    panels = chart.panels
    # Random ids and the date would change every file; texts must not need the reader's fonts.
    with rc_context({"svg.hashsalt": "cmf-mj", "svg.fonttype": "path"}):
        figure = Figure(figsize=(7.2, chart_height(chart) / 105.0), layout="constrained")
        heights = [panel.height for panel in panels]
        options: dict[str, Any] = {"sharex": True, "height_ratios": heights}
        every = figure.subplots(len(panels), 1, squeeze=False, **options)[:, 0]
        handles: dict[str, Any] = {}
        for axes, panel in zip(every, panels, strict=True):
            handles = plot_curves(axes, panel.curves, scale=0.7) | handles
            axes.set_ylabel(panel.y_title, fontsize=8)
            if panel.y_range is not None:
                axes.set_ylim(*panel.y_range)
            if panel.y_tick is not None:
                axes.yaxis.set_major_locator(MultipleLocator(panel.y_tick))
            for level in panel.guides:
                axes.axhline(level, color="0.6", linewidth=0.7, linestyle=":")
            axes.grid(True, color="0.9", linewidth=0.5)
            axes.tick_params(labelsize=7)
        last = every[-1]
        last.set_xlabel(panels[-1].x_title, fontsize=8)
        last.set_xlim(panels[-1].x_range)
        if panels[-1].x_log:
            last.set_xscale("log")
            last.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            last.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            last.xaxis.set_minor_formatter(NullFormatter())
        names = list(dict.fromkeys(curve.name for panel in panels for curve in panel.curves))
        figure.legend(
            [handles[name] for name in names],
            names,
            loc="outside upper left",
            ncols=2,
            fontsize=7,
            frameon=False,
        )
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()
