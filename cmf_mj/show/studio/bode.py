"""Frequency response of the law in force, measured on demand in a thread of its own.

The run is `cmf run`'s of a scenario with the machine and the law of the session and the facility's
sweep amplitude as a multisine; the response is `frequency_response`'s.
"""

import threading
from collections.abc import Callable
from concurrent.futures import CancelledError
from typing import NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from cmf_mj.analysis.frequency_response import Bandwidths, bandwidths, frequency_response
from cmf_mj.core import units
from cmf_mj.facility.scenario.run import run_scenario
from cmf_mj.facility.scenario.settings import Scenario, scenario_of
from cmf_mj.machine.dof import dof_unit
from cmf_mj.show.studio.choices import settled
from cmf_mj.show.studio.desk import Desk
from cmf_mj.show.studio.plots import axes
from cmf_mj.studies.measurement import RECORD_EVERY, dof_amplitude

PERIOD = 20.0
"""Period of the multisine [s]: lines 0.1 Hz apart from 0.05 to 10 Hz."""

PERIODS = 3
"""Periods in all; the first is the transient."""

FADE = 1.0
"""Of the two ends of the multisine [s]."""


class Measured(NamedTuple):
    """A response and what it is of."""

    title: str
    frequency: NDArray[np.float64]  #: [Hz], (K,).
    gain: NDArray[np.float64]  #: [dB], (K,).
    phase: NDArray[np.float64]  #: [deg], (K,).
    bandwidths: Bandwidths


class Cancelled(Exception):
    """The page has gone while its measurement ran."""


def sweep_scenario(scenario: Scenario, dof: str) -> Scenario:
    """The measuring run of a session: same machine and law, from rest, with a multisine.

    Args:
        scenario: of the session so far.
        dof: degree of freedom.
    """
    unit = dof_unit(dof)
    signal = {
        "kind": "multisine",
        "dof": dof,
        "amplitude": (units.from_si(unit, dof_amplitude(dof, None)), unit),
        "start": 1.0 / PERIOD,
        "period": PERIOD,
        "periods": PERIODS,
        "fade": FADE,
    }
    sweep = scenario_of({"signal": [signal]}, "bode").signal
    return settled(scenario).model_copy(
        update={
            "signal": sweep,
            "operation": None,
            "duration": PERIOD * PERIODS + FADE,
            "record_every": RECORD_EVERY,
        }
    )


def measure(
    scenario: Scenario, dof: str, progress: Callable[[int, int], None] | None = None
) -> Measured:
    """Measure the response of a session's machine and law.

    Args:
        scenario: of the session so far.
        dof: degree of freedom.
        progress: called with control frames done and in all.

    Raises:
        InputError: the scenario cannot be run.
        OutOfBounds: the loop with this law left its physical bounds.
    """
    sweep = sweep_scenario(scenario, dof)
    response = frequency_response(run_scenario(sweep, progress=progress), dof)
    own = ", gains changed" if sweep.gains else ""
    return Measured(
        f"{sweep.law}{own}, {dof}, {sweep.cab}, {sweep.hydraulics}",
        response.frequency,
        response.gain_db,
        response.phase_deg,
        bandwidths(response),
    )


def told(found: Bandwidths) -> str:
    """Bandwidths in a line; a dash where there is none within the lines."""
    phase, gain = (
        "-" if np.isnan(value) else f"{value:.2f} Hz" for value in (found.phase_hz, found.gain_hz)
    )
    return f"-90 deg at {phase}, -3 dB at {gain}, peak {found.peak_db:.1f} dB"


class BodePanel:
    """Button, progress, two plots and the bandwidths."""

    def __init__(self, desk: Desk, dof: Callable[[], str]) -> None:
        """Add them to the container in force.

        Args:
            desk: the page.
            dof: tells the degree of freedom chosen.
        """
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
        self._gain = self._plot("gain [dB]", (-6.0, 3.0))
        self._phase = self._plot("phase [deg]", (-180.0, 0.0))
        self._button.on_click(lambda _: self._start())

    def close(self) -> None:
        """Let a running measurement go."""
        self._gone.set()

    def _plot(self, title: str, soft: tuple[float, float]) -> viser.GuiUplotHandle:
        empty = np.array([0.1, 10.0])
        low, high = ({"pad": 0.05, "soft": limit, "mode": 1} for limit in soft)
        return self._desk.client.gui.add_uplot(
            (empty, np.full(2, np.nan), np.full(2, np.nan)),
            (
                uplot.Series(label="f [Hz]"),
                uplot.Series(label="before", stroke="#8a9099", width=1.5, dash=(5, 4)),
                uplot.Series(label="now", stroke="#1f77b4", width=2.0),
            ),
            title=f"{title} over frequency [Hz]",
            scales={
                "x": uplot.Scale(time=False, distr=3),
                "y": uplot.Scale(range={"min": low, "max": high}),
            },
            axes=axes(),
            legend=uplot.Legend(show=True, live=False),
            height=230,
            padding=(4, 12, 0, 0),
        )

    def _start(self) -> None:
        if self._thread is not None and self._thread.is_alive():
            return
        self._thread = threading.Thread(target=self._measure, name="studio bode", daemon=True)
        self._thread.start()

    def _measure(self) -> None:
        self._button.disabled, self._progress.visible = True, True

        def progress(done: int, total: int) -> None:
            if self._gone.is_set():
                raise Cancelled
            self._progress.value = 100.0 * done / total

        try:
            found = measure(self._desk.live.scenario().result(), self._dof(), progress)
        except (Cancelled, CancelledError):
            return
        except (ValueError, FloatingPointError) as error:
            self._desk.tell(error)
        else:
            self._show(found)
        self._button.disabled, self._progress.visible = False, False

    def _show(self, found: Measured) -> None:
        before = self._before or found
        self._before = found
        grid = found.frequency
        for plot, name in ((self._gain, "gain"), (self._phase, "phase")):
            old = np.interp(grid, before.frequency, getattr(before, name))
            plot.data = (grid, old, getattr(found, name))
        self._text.content = f"**{found.title}**  \n{told(found.bandwidths)}"
        if before is not found:
            self._text.content += f"  \n*before: {before.title}: {told(before.bandwidths)}*"
