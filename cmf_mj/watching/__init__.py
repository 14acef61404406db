"""Runs and modes as pictures: off-screen films, and MuJoCo's viewer on a live run."""

from cmf_mj.watching.film import FilmSettings, check_film, film, model_of
from cmf_mj.watching.stage import Stage, choose_backend, has_display
from cmf_mj.watching.strip import Curve, Panel, Traces
from cmf_mj.watching.swing import SwingSettings, swing_film
from cmf_mj.watching.view import LiveView, show

__all__ = [
    "Curve",
    "FilmSettings",
    "LiveView",
    "Panel",
    "Stage",
    "SwingSettings",
    "Traces",
    "check_film",
    "choose_backend",
    "film",
    "has_display",
    "model_of",
    "show",
    "swing_film",
]
