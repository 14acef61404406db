"""Frequency response of the law in force, measured on demand in a separate thread.

The run is `cmf run`'s of a scenario with the machine and the law of the session and the facility's
sweep amplitude as a multisine; the response is `frequency_response`'s.
"""

import threading
from collections.abc import Callable
from concurrent.futures import CancelledError
from typing import NamedTuple

import numpy as np

from cmf_mj.analysis.frequency_response import (
    Bandwidths,
    FrequencyResponse,
    bandwidths,
    frequency_response,
)
from cmf_mj.core import units
from cmf_mj.facility.scenario.run import run_scenario
from cmf_mj.facility.scenario.settings import Scenario, scenario_of
from cmf_mj.machine.dof import dof_unit
from cmf_mj.show.look import BLUE
from cmf_mj.show.studio.choices import settled
from cmf_mj.show.studio.desk import Desk
from cmf_mj.show.studio.plots import DASHED, PALE, Line, add_plot
from cmf_mj.studies.case import RECORD_EVERY, dof_amplitude

PERIOD = 20.0
"""Period of the multisine [s]: lines 0.1 Hz apart from 0.05 to 10 Hz."""

PERIODS = 3
"""Periods in all; the first is the transient."""

FADE = 1.0
"""Of the two ends of the multisine [s]."""


class Measured(NamedTuple):
    """A response and what it is of."""

    title: str
    response: FrequencyResponse

    @property
    def text(self) -> str:
        """Title and bandwidths."""
        return f"{self.title}: {bandwidth_text(bandwidths(self.response))}"


class Cancelled(Exception):
    """The page has gone while its measurement ran."""


def measure(
    scenario: Scenario, dof: str, progress: Callable[[int, int], None] | None = None
) -> Measured:
    """Measure the response of a session's machine and law: from rest, with a multisine."""
    unit = dof_unit(dof)
    signal = {
        "kind": "multisine",
        "dof": dof,
        "amplitude": (units.from_si(unit, dof_amplitude(dof)), unit),
        "start": 1.0 / PERIOD,
        "period": PERIOD,
        "periods": PERIODS,
        "fade": FADE,
    }
    sweep = settled(scenario).model_copy(
        update={
            "signal": scenario_of({"signal": [signal]}, "bode").signal,
            "operation": None,
            "duration": PERIOD * PERIODS + FADE,
            "record_every": RECORD_EVERY,
        }
    )
    response = frequency_response(run_scenario(sweep, progress=progress), dof)
    changed = ", gains changed" if sweep.gains else ""
    return Measured(f"{sweep.law}{changed}, {dof}, {sweep.cab}, {sweep.hydraulics}", response)


def bandwidth_text(widths: Bandwidths) -> str:
    """Bandwidths in a line; a dash where there is none within the lines."""
    phase, gain = (
        "-" if np.isnan(value) else f"{value:.2f} Hz" for value in (widths.phase_hz, widths.gain_hz)
    )
    return f"-90 deg at {phase}, -3 dB at {gain}, peak {widths.peak_db:.1f} dB"


class BodePanel:
    """Button, progress, two plots and the bandwidths."""

    def __init__(self, desk: Desk, dof: Callable[[], str]) -> None:
        """Add them to the container in force; `dof` returns the degree of freedom chosen."""
        gui = desk.client.gui
        self._desk, self._dof = desk, dof
        self._gone = threading.Event()
        self._thread: threading.Thread | None = None
        self._before: Measured | None = None
        self._button = gui.add_button("measure the response", icon="wave-sine")
        self._progress = gui.add_progress_bar(0.0, visible=False)
        self._text = gui.add_markdown(
            "From leg demand to leg feedback in the signal's degree of freedom, with the present "
            "law, gains, cab and plant set. Dashed: the measurement before."
        )
        lines = (Line("before", PALE, DASHED), Line("now", BLUE))
        self._gain, self._phase = (
            add_plot(desk.client, f"{title} over frequency [Hz]", lines, soft, frequency=True)
            for title, soft in (("gain [dB]", (-6.0, 3.0)), ("phase [deg]", (-180.0, 0.0)))
        )
        self._button.on_click(lambda _: self._start())

    def close(self) -> None:
        """Let a running measurement go."""
        self._gone.set()

    def _start(self) -> None:
        if self._thread is None or not self._thread.is_alive():
            self._thread = threading.Thread(target=self._measure, name="studio bode", daemon=True)
            self._thread.start()

    def _measure(self) -> None:
        self._button.disabled, self._progress.visible = True, True

        def progress(done: int, total: int) -> None:
            if self._gone.is_set():
                raise Cancelled
            self._progress.value = 100.0 * done / total

        try:
            measured = measure(self._desk.live.scenario().result(), self._dof(), progress)
        except (Cancelled, CancelledError):
            return
        except (ValueError, FloatingPointError) as error:
            self._desk.tell(error)
        else:
            self._show(measured)
        self._button.disabled, self._progress.visible = False, False

    def _show(self, measured: Measured) -> None:
        before, self._before = self._before or measured, measured
        now, old = measured.response, before.response
        for plot, curve, dashed in (
            (self._gain, now.gain_db, old.gain_db),
            (self._phase, now.phase_deg, old.phase_deg),
        ):
            plot.data = (now.frequency, np.interp(now.frequency, old.frequency, dashed), curve)
        self._text.content = f"**{measured.text}**"
        if before is not measured:
            self._text.content += f"  \n*before: {before.text}*"
