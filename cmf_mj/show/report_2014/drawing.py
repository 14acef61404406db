"""Charts as plotly figures for the screen and as SVG pictures for print."""

import io
import math
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MultipleLocator, NullFormatter

from cmf_mj.core.errors import require
from cmf_mj.show.chart import Chart, Curve, Panel, plot_curves

_PANEL, _MARGIN = 230, 96
"""Height of a panel and of what surrounds all [px]."""


def chart_height(chart: Chart) -> int:
    """Height on the screen [px]."""
    return _MARGIN + round(sum(panel.height for panel in chart.panels) * _PANEL)


def _axis_panel(panel: Panel, panels: tuple[Panel, ...]) -> Panel:
    """The panel whose x axis it has: the next with a title."""
    following = panels[panels.index(panel) :]
    return next(candidate for candidate in following if candidate.x_title)


def _axis(title: str, limits: tuple[float, float] | None, *, log: bool) -> dict[str, Any]:
    scaled = [math.log10(v) for v in limits] if limits and log else limits and list(limits)
    kind = {"type": "log" if log else "linear", "range": scaled}
    return {"title": {"text": title}, **kind, "gridcolor": "#e5e5e5", "zeroline": False}


def _log_ticks(limits: tuple[float, float] | None) -> list[float] | None:
    """1, 2 and 5 of each decade within the limits."""
    if limits is None:
        return None
    low, high = math.floor(math.log10(limits[0])), math.ceil(math.log10(limits[1]))
    ticks = [float(f"{m}e{e}") for e in range(low, high + 1) for m in (1, 2, 5)]
    return [tick for tick in ticks if limits[0] <= tick <= limits[1]]


def _guide(level: float, suffix: str) -> dict[str, Any]:
    where = {"xref": f"x{suffix} domain", "yref": f"y{suffix}"}
    ends = {"x0": 0, "x1": 1, "y0": level, "y1": level}
    return {
        "type": "line",
        **where,
        **ends,
        "line": {"color": "#999999", "width": 1, "dash": "dot"},
    }


def _trace(line: Curve, suffix: str, *, in_legend: bool) -> dict[str, Any]:
    colour = {"color": line.colour}
    return {
        "type": "scatter",
        "name": line.name,
        "legendgroup": line.name,
        "showlegend": in_legend,
        "x": line.x,
        "y": line.y,
        "xaxis": f"x{suffix}",
        "yaxis": f"y{suffix}",
        "mode": "markers" if line.marks else "lines",
        "line": {**colour, "width": line.width, "dash": line.dash, "simplify": False},
        "marker": {**colour, "size": 9, "symbol": "circle-open", "line": {"width": 2}},
        "hovertemplate": "%{x:.4g}, %{y:.4g}<extra>%{fullData.name}</extra>",
    }


def plotly_json(chart: Chart) -> str:
    """The chart as JSON of a plotly figure; the same bytes for the same chart."""
    graph = require("plotly.graph_objects", "report")
    total = sum(panel.height for panel in chart.panels)
    layout: dict[str, Any] = {
        "template": "none",
        "height": chart_height(chart),
        "margin": {"l": 62, "r": 12, "t": 44, "b": 52},
        "hovermode": "closest",
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0.0},
        "font": {"family": "system-ui, sans-serif", "size": 12},
        "shapes": [],
    }
    traces: list[dict[str, Any]] = []
    names: set[str] = set()
    top = 1.0
    for index, panel in enumerate(chart.panels):
        suffix = "" if index == 0 else str(index + 1)
        shared = _axis_panel(panel, chart.panels)
        share = panel.height / total
        last = index == len(chart.panels) - 1
        gap = 0.0 if last else 0.2 if panel.x_title else 0.08
        bottom = top - share
        layout[f"yaxis{suffix}"] = {
            **_axis(panel.y_title, panel.y_range, log=False),
            "domain": [round(max(bottom + gap * share, 0.0), 4), round(top, 4)],
            "dtick": panel.y_tick,
            "anchor": f"x{suffix}",
        }
        across = _axis(panel.x_title, shared.x_range, log=shared.x_log)
        across["title"]["standoff"] = 6
        layout[f"xaxis{suffix}"] = {
            **across,
            "tickvals": _log_ticks(shared.x_range) if shared.x_log else None,
            "anchor": f"y{suffix}",
            "showticklabels": bool(panel.x_title),
            "matches": None if shared is panel else f"x{chart.panels.index(shared) + 1}",
        }
        layout["shapes"] += [_guide(level, suffix) for level in panel.guides]
        for line in panel.curves:
            traces.append(_trace(line, suffix, in_legend=line.name not in names))
            names.add(line.name)
        top = bottom
    return str(graph.Figure(data=traces, layout=layout).to_json())


def _dress(axes: Axes, panel: Panel, shared: Panel) -> None:
    axes.set_ylabel(panel.y_title, fontsize=8)
    if shared.x_log:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    if shared.x_range is not None:
        axes.set_xlim(*shared.x_range)
    if panel.y_range is not None:
        axes.set_ylim(*panel.y_range)
    if panel.y_tick is not None:
        axes.yaxis.set_major_locator(MultipleLocator(panel.y_tick))
    for level in panel.guides:
        axes.axhline(level, color="0.6", linewidth=0.7, linestyle=":")
    axes.grid(True, color="0.9", linewidth=0.5)
    axes.tick_params(labelsize=7, labelbottom=bool(panel.x_title))
    if panel.x_title:
        axes.set_xlabel(panel.x_title, fontsize=8)


def still(chart: Chart) -> str:
    """The chart as an SVG picture, texts as outlines; the same bytes for the same chart."""
    # Random ids and the date would make each file another; texts need no font of the reader's.
    with rc_context({"svg.hashsalt": "cmf-mj", "svg.fonttype": "path"}):
        figure = Figure(figsize=(7.2, chart_height(chart) / 105.0), layout="constrained")
        ratios = [panel.height for panel in chart.panels]
        grid = figure.subplots(len(chart.panels), 1, squeeze=False, height_ratios=ratios)[:, 0]
        handles: dict[str, Any] = {}
        for axes, panel in zip(grid, chart.panels, strict=True):
            for name, handle in plot_curves(axes, panel.curves, scale=0.7).items():
                handles.setdefault(name, handle)
            _dress(axes, panel, _axis_panel(panel, chart.panels))
        figure.legend(
            list(handles.values()),
            list(handles),
            loc="outside upper left",
            ncols=2,
            fontsize=7,
            frameon=False,
        )
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()
