"""Thumbnails of the gallery: of each picture one curve, and no words."""

from typing import Any

import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from sphinx_gallery.scrapers import matplotlib_scraper


def reduce(figure: Figure) -> Figure:
    """Leave the first axes, and of their curves the first, a solid one if there is one.

    Without curves, bars, images and colours stay.
    """
    axes, *others = [axes for axes in figure.axes if axes.has_data()]
    curves = [line for line in axes.lines if len(line.get_xdata()) > 2]
    curves.sort(key=lambda line: line.get_linestyle() != "-")
    areas = axes.collections if not curves else []
    gone = [*others, *figure.legends, *figure.texts, *axes.texts, *areas[1:]]
    gone += [line for line in axes.lines if line not in curves[:1]]
    for each in (*gone, *filter(None, [axes.get_legend()])):
        each.remove()
    for line in curves[:1]:
        line.set_linewidth(3.0)
        axes.relim()
        axes.autoscale()
    figure.set_layout_engine("none")
    figure.set_size_inches(4.0, 2.8)
    axes.set(title="", xlabel="", ylabel="", anchor="C", position=(0.02, 0.02, 0.96, 0.96))
    axes.tick_params(which="both", length=0.0, labelbottom=False, labelleft=False)
    axes.grid(False)
    return figure


def scrape(block: Any, variables: Any, conf: Any) -> str:
    """Save the picture, and before it, as the first of the script, its thumbnail."""
    shown = [plt.figure(number) for number in plt.get_fignums()]
    places = [next(variables["image_path_iterator"]) for _ in shown]
    text = matplotlib_scraper(block, variables, conf)
    for figure, place in zip(shown, places, strict=True):
        reduce(figure).savefig(place, dpi=100)
    return str(text)


def _get_sg_image_scraper() -> Any:
    return scrape
