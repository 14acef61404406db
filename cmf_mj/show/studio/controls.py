"""Controls of a page, folder by folder."""

import math
import tempfile
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any, get_args

import viser

from cmf_mj.control.law import Law, law_names, load_law
from cmf_mj.core import units
from cmf_mj.facility.scenario.library import scenario_toml
from cmf_mj.facility.scenario.settings import Change, Push, Scenario, change_of, overlaid_law
from cmf_mj.machine import models
from cmf_mj.machine.geometry import DOFS, dof_unit
from cmf_mj.plant.events import KINDS, default_event
from cmf_mj.plant.parameters import HYDRAULICS, hydraulics_of
from cmf_mj.show.studio import choices
from cmf_mj.show.studio.choices import Knob, knobs, words
from cmf_mj.show.studio.desk import Desk, by_hand, pick
from cmf_mj.show.studio.live import View
from cmf_mj.signals.signal import SingleSignal

SPEEDS = {"1": 1.0, "1/2": 0.5, "1/5": 0.2, "1/10": 0.1, "1/50": 0.02}
"""Slow motion: simulated over wall time."""

LEGS = tuple("123456")

_HERTZ = ("frequency", "start", "stop", "corner")
"""Settings of signals in Hz; numbers with a point among the others are in s."""

NONE = "none"
"""Choice of no second law."""

_STEPS = 200
"""Steps of a gain's slider from end to end."""


_GOOD, _FAILED, _TRIPPED = "#2f9e44", "#f08c00", "#d62728"

_LISTED = 3
"""Marks that the lamp lists at most."""


def lamp(view: View) -> str:
    """HTML of a lamp: green; amber while something has failed; red once it tripped or ended."""
    harm = [mark for mark in view.marks if mark.harm]
    colour, says = _GOOD, "all works"
    if view.end:
        colour, says = _TRIPPED, f"ended: {view.end}"
    elif (fault := view.live.fault) is not None:
        colour, says = _TRIPPED, f"tripped: {words(fault.name, fault.leg)}"
    elif harm or view.live.late:
        colour, says = _FAILED, "failed" if harm else "host late"
    marks = "".join(f"<br>{mark.time:.1f} s: {escape(mark.text)}" for mark in view.marks[-_LISTED:])
    dot = f"<span style='color:{colour};font-size:1.6em;line-height:0.6'>&#9679;</span>"
    return f"<div style='padding:0 0.8em;font-size:0.9em'>{dot} <b>{escape(says)}</b>{marks}</div>"


def run_controls(desk: Desk) -> Callable[[View], None]:
    """Pause, reset and slow motion; brings what it says of the session up to date."""
    gui = desk.client.gui
    light = gui.add_html("")
    status = gui.add_markdown("starting ...")
    buttons = gui.add_button_group(
        "run", ("pause", "go on", "reset"), hint="reset: from rest, all repaired"
    )
    speed = gui.add_dropdown("speed", tuple(SPEEDS), hint="simulated over wall time")
    by_hand(lambda chosen: desk.live.set_speed(SPEEDS[chosen.value]), speed)

    @buttons.on_click
    def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
        if event.target.value == "reset":
            desk.again()
        else:
            desk.live.pause(event.target.value == "pause")

    def show(view: View) -> None:
        live, pace = view.live, view.pace
        lines = [f"**t = {live.time:.1f} s** {'(paused)' if view.paused else ''}"]
        if not math.isnan(pace.capacity):
            lines += [f"real-time factor {pace.capacity:.1f}, paced to {pace.factor:.2f}"]
        if pace.given_up > 0.0:
            lines += [f"too slow: {pace.given_up:.1f} s given up"]
        lines += [f"law {live.law}" + (f", {live.state}" if live.state else "")]
        if light.content != (html := lamp(view)):
            light.content = html
        status.content = "  \n".join(lines)

    return show


class SignalControls:
    """The demand: degree of freedom, kind, amplitude and the settings of its kind."""

    def __init__(self, desk: Desk) -> None:
        """Add them to the container in force."""
        gui = desk.client.gui
        self._desk, self._machine = desk, models.CMF
        self._dof = gui.add_dropdown(
            "DOF", DOFS, initial_value="heave", hint="degree of freedom that moves and is drawn"
        )
        self._kind = gui.add_dropdown(
            "signal",
            ("rest", *choices.SIGNALS),
            initial_value="sine",
            hint="demand of the platform; takes over within 1 s",
        )
        self._amplitude = gui.add_slider(
            "amplitude", 0.05, 41.0, 0.05, 2.0, hint="up to the operational excursion"
        )
        self._folder = gui.add_folder("settings")
        self._settings: dict[str, Any] = {}
        by_hand(self._moved, self._dof, self._kind, self._amplitude)
        again = gui.add_button("send again", hint="step, pulse and chirp once more")
        again.on_click(lambda _: desk.later("signal", self._send))
        desk.follow(self._follow)

    @property
    def dof(self) -> str:
        """Degree of freedom chosen."""
        return self._dof.value

    def _send(self) -> None:
        settings = {name: handle.value for name, handle in self._settings.items()}
        table = choices.signal_table(self._kind.value, self.dof, self._amplitude.value, **settings)
        self._desk.apply(change_of({"signal": table}, "signal"))

    def _follow(self, scenario: Scenario) -> None:
        """Show the signal of a scenario, where the page has such a one."""
        self._machine = scenario.machine
        signals = scenario.signal
        if not signals:
            self._kind.value = "rest"
        settings: dict[str, Any] = {}
        if len(signals) == 1 and isinstance(signals[0], SingleSignal):
            signal = signals[0]
            self._kind.value, self._dof.value = signal.kind, signal.dof
            self._amplitude.value = abs(units.from_si(dof_unit(signal.dof), signal.size))
            settings = signal.model_dump()
        self._limit()
        self._show_settings(settings)

    def _moved(self, handle: Any) -> None:
        if handle is self._dof:
            self._limit()
        if handle is self._kind:
            self._show_settings({})
        self._desk.later("signal", self._send)

    def _limit(self) -> None:
        """Scale the amplitude to the degree of freedom."""
        self._amplitude.label = f"amplitude [{dof_unit(self.dof)}]"
        self._amplitude.max = choices.largest_amplitude(self.dof, self._machine)
        self._amplitude.value = min(self._amplitude.value, self._amplitude.max)

    def _show_settings(self, chosen: dict[str, Any]) -> None:
        """One control for each setting of the kind, by its type."""
        gui, kind = self._desk.client.gui, self._kind.value
        for handle in self._settings.values():
            handle.remove()
        self._settings.clear()
        for name, begun in choices.signal_settings(kind).items():
            value = chosen.get(name, begun)
            with self._folder:
                if isinstance(value, str):
                    options = get_args(choices.SIGNALS[kind].model_fields[name].annotation)
                    self._settings[name] = gui.add_dropdown(name, options, initial_value=value)
                    continue
                unit = "Hz" if name in _HERTZ else "s"
                whole = isinstance(value, int)
                label, step = (name, 1) if whole else (f"{name} [{unit}]", 0.05)
                self._settings[name] = gui.add_number(label, value, step=step)
        by_hand(self._moved, *self._settings.values())


def law_controls(desk: Desk) -> None:
    """The law, and a slider for each of its gains."""
    gui = desk.client.gui
    chosen = gui.add_dropdown(
        "law", law_names("all"), initial_value="velocity", hint="takes over while the machine moves"
    )
    second = gui.add_dropdown(
        "second law",
        (NONE, *law_names("all")),
        hint="a second machine with this law does the same, drawn beside; begins a new run",
    )
    folder = gui.add_folder("gains", expand_by_default=False)
    sliders: list[viser.GuiSliderHandle[float]] = []

    def choose(_: Any) -> None:
        desk.apply(Change(law=chosen.value))
        show(load_law(chosen.value))

    def follow(scenario: Scenario) -> None:
        pick(chosen, scenario.law)
        show(overlaid_law(load_law(scenario.law), scenario.gains))

    def show(law: Law) -> None:
        for slider in sliders:
            slider.remove()
        with folder:
            sliders[:] = [add_slider(knob) for knob in knobs(law)]

    def add_slider(knob: Knob) -> viser.GuiSliderHandle[float]:
        step = (knob.high - knob.low) / _STEPS
        slider = gui.add_slider(knob.label, knob.low, knob.high, step, knob.value, hint=knob.hint)

        def moved(_: Any) -> None:
            change = Change(gains=knob.table(slider.value))
            desk.later(knob.hint, lambda: desk.apply(change))

        by_hand(moved, slider)
        return slider

    def compare(_: Any) -> None:
        desk.beside = "" if second.value == NONE else second.value
        desk.again()

    by_hand(choose, chosen)
    by_hand(compare, second)
    desk.follow(follow)


def machine_controls(desk: Desk) -> None:
    """Cab, plant set and protection: each begins a new run."""
    gui = desk.client.gui
    cab = gui.add_dropdown("cab", models.CABS, hint="its mass, inertia and centre of mass")
    hydraulics = gui.add_dropdown(
        "plant set", HYDRAULICS, initial_value="hardware", hint="oil, valves, leakage and supply"
    )
    protection = gui.add_checkbox(
        "protection", False, hint="fault detection that makes an emergency stop"
    )
    gui.add_markdown("*A change here begins a new run.*")

    def moved(_: Any) -> None:
        protected = "default" if protection.value else None
        chosen = hydraulics.value if hydraulics.value in HYDRAULICS else None
        desk.again(cab=cab.value, hydraulics=chosen, protection=protected)

    def follow(scenario: Scenario) -> None:
        carrier = scenario.carried.machine
        cab.options = carrier.cab_names
        hydraulics.options = HYDRAULICS if carrier.name == models.CMF else (carrier.name,)
        pick(cab, scenario.carried.name)
        pick(hydraulics, hydraulics_of(carrier, scenario.hydraulics).name)
        protection.value = scenario.protection is not None

    by_hand(moved, cab, hydraulics, protection)
    desk.follow(follow)


def disturbance_controls(desk: Desk) -> None:
    """A push on the platform, and failures."""
    gui = desk.client.gui
    direction = gui.add_dropdown(
        "push", tuple(choices.DIRECTIONS), hint="force on the platform's centre of mass"
    )
    size = gui.add_slider(
        "force [kN]", 1.0, choices.LARGEST_PUSH, 1.0, 20.0, hint="100 kN: 3/4 of the weight"
    )
    on = gui.add_checkbox("push now", False, hint="lasts until it is switched off")
    kind = gui.add_dropdown(
        "failure", KINDS, initial_value="pump_lost", hint="lasts until the run is reset"
    )
    leg = gui.add_dropdown("leg", LEGS, hint="of a valve or sensor")
    fail = gui.add_button("fail now", color="red", hint="let it fail in the next frame")

    def push() -> None:
        force = choices.push_of(direction.value, size.value) if on.value else Push()
        desk.apply(Change(push=force))

    def moved(handle: Any) -> None:
        if on.value or handle is on:
            desk.later("push", push)

    @fail.on_click
    def _(_: Any) -> None:
        needs_leg = default_event(kind.value, 0.0).leg is not None
        failure = {"kind": kind.value, "leg": int(leg.value) if needs_leg else None}
        desk.apply(change_of({"failure": [failure]}))

    by_hand(moved, direction, size, on)
    desk.follow(lambda _: setattr(on, "value", False))  # a new run begins without a push


def file_controls(desk: Desk) -> None:
    """The session as a scenario, and its record."""
    gui, send = desk.client.gui, desk.client.send_file_download
    export = gui.add_button(
        "export scenario", icon="download", hint="`cmf run` repeats this session bit for bit"
    )
    save = gui.add_button(
        "save record", icon="download", hint="what the session has kept, as Parquet"
    )

    @export.on_click
    def _(_: Any) -> None:
        text = scenario_toml(desk.live.scenario().result())
        send("session.toml", text.encode("utf-8"), save_immediately=True)

    @save.on_click
    def _(_: Any) -> None:
        record = desk.live.record().result()
        with tempfile.TemporaryDirectory() as folder:
            content = record.save(Path(folder) / "session.parquet").read_bytes()
        send("session.parquet", content, save_immediately=True)
