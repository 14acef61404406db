"""Controls of a page, folder by folder."""

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import viser

from cmf_mj.control.law import law_names
from cmf_mj.core import units
from cmf_mj.facility.run import Run
from cmf_mj.facility.scenario import scenario_toml
from cmf_mj.facility.settings import Change, Push, change_of
from cmf_mj.machine import models
from cmf_mj.machine.geometry import DOFS, by_kind, dof_unit
from cmf_mj.plant.events import KINDS, default_event
from cmf_mj.plant.parameters import HYDRAULICS, hydraulics_of
from cmf_mj.show.studio.desk import (
    DIRECTIONS,
    LARGEST_PUSH,
    SIGNALS,
    Desk,
    by_hand,
    largest_amplitude,
    law_of,
    pick,
    ready_scenarios,
    signal_settings,
    signal_table,
    weight,
)
from cmf_mj.show.studio.live import View
from cmf_mj.show.studio.plots import UNITS, lamp
from cmf_mj.signals.signal import SingleSignal

SPEEDS = {"1": 1.0, "1/2": 0.5, "1/5": 0.2, "1/10": 0.1, "1/50": 0.02}
"""Slow motion: simulated over wall time."""

LEGS = tuple("123456")

_HERTZ = ("frequency", "start", "stop", "corner")
"""Settings of signals in Hz; numbers with a point among the others are in s."""


def scenario_controls(desk: Desk) -> None:
    """The ready scenarios by title."""
    ready = {run.title: run for run in ready_scenarios().values()}
    chosen = desk.client.gui.add_dropdown("scenario", tuple(ready), hint="begins it from rest")

    def follow(scenario: Run) -> None:
        pick(chosen, ready.setdefault(scenario.title, scenario).title)

    by_hand(lambda _: desk.begin(ready[chosen.value]), chosen)
    desk.follow(follow)


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
            desk.again(events=())
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
        light.content = lamp(view)
        status.content = "  \n".join(lines)

    return show


def signal_controls(desk: Desk) -> Callable[[], tuple[str, str]]:
    """The demand: its kind, settings and amplitude; gives degree of freedom and units chosen."""
    gui = desk.client.gui
    system = gui.add_dropdown("units", tuple(UNITS), hint="of the amplitude and the plots")
    dof = gui.add_dropdown(
        "DOF", DOFS, initial_value="heave", hint="degree of freedom that moves and is drawn"
    )
    kind = gui.add_dropdown(
        "signal",
        ("rest", *SIGNALS),
        initial_value="sine",
        hint="demand of the platform; takes over within 1 s",
    )
    amplitude = gui.add_slider(
        "amplitude", 0.05, 41.0, 0.05, 2.0, hint="up to the operational excursion"
    )
    folder = gui.add_folder("settings")
    settings: dict[str, Any] = {}
    shown = 1.0

    def size() -> float:
        """The amplitude in in or deg."""
        return round(amplitude.value / shown, 4)

    def send() -> None:
        chosen = {name: handle.value for name, handle in settings.items()}
        table = signal_table(kind.value, dof.value, size(), **chosen)
        desk.apply(change_of({"signal": table}, "signal"))

    def limit(chosen: float) -> None:
        """Show an amplitude [in or deg] and its limit in the units of the page."""
        nonlocal shown
        largest = largest_amplitude(dof.value, desk.carried.machine.name)
        unit = by_kind(dof.value, *UNITS[system.value][:2])
        shown = units.from_si(unit, units.to_si(dof_unit(dof.value), 1.0))
        amplitude.label, amplitude.max = f"amplitude [{unit}]", round(shown * largest, 1)
        amplitude.value = round(shown * min(chosen, largest), 2)

    def moved(handle: Any) -> None:
        if handle in (dof, system):
            limit(size())
        if handle is kind:
            show_settings({})
        if handle is not system:
            desk.later("signal", send)

    def follow(scenario: Run) -> None:
        """Show the signal of a scenario, where the page has such a one."""
        begun, chosen = size(), dict[str, Any]()
        if not scenario.signal:
            kind.value = "rest"
        if len(scenario.signal) == 1 and isinstance(signal := scenario.signal[0], SingleSignal):
            kind.value, dof.value = signal.kind, signal.dof
            begun = abs(units.from_si(dof_unit(signal.dof), signal.size))
            chosen = signal.model_dump()
        limit(begun)
        show_settings(chosen)

    def show_settings(chosen: dict[str, Any]) -> None:
        """One control for each setting of the kind, by its type."""
        for handle in settings.values():
            handle.remove()
        settings.clear()
        for name, begun in signal_settings(kind.value).items():
            value = chosen.get(name, begun)
            with folder:
                if isinstance(value, str):
                    options = get_args(SIGNALS[kind.value].model_fields[name].annotation)
                    settings[name] = gui.add_dropdown(name, options, initial_value=value)
                    continue
                unit = "Hz" if name in _HERTZ else "s"
                whole = isinstance(value, int)
                label, step = (name, 1) if whole else (f"{name} [{unit}]", 0.05)
                settings[name] = gui.add_number(label, value, step=step)
        by_hand(moved, *settings.values())

    by_hand(moved, system, dof, kind, amplitude)
    again = gui.add_button("send again", hint="step, pulse and chirp once more")
    again.on_click(lambda _: desk.later("signal", send))
    desk.follow(follow)
    return lambda: (dof.value, system.value)


def law_controls(desk: Desk) -> None:
    """The law."""
    chosen = desk.client.gui.add_dropdown(
        "law",
        law_names("all"),
        initial_value="velocity",
        hint="takes over while the machine moves",
    )
    by_hand(lambda _: desk.apply(Change(law=chosen.value)), chosen)
    desk.follow(lambda scenario: pick(chosen, law_of(scenario)))


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

    def follow(scenario: Run) -> None:
        carrier = scenario.carried.machine
        cab.options = tuple(carrier.cabs)
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
        "push", tuple(DIRECTIONS), hint="force on the platform's centre of mass"
    )
    size = gui.add_slider("force [%]", 1.0, LARGEST_PUSH, 1.0, 15.0, hint="of the weight")
    on = gui.add_checkbox("push now", False, hint="lasts until it is switched off")
    kind = gui.add_dropdown(
        "failure", KINDS, initial_value="pump_lost", hint="lasts until the run is reset"
    )
    leg = gui.add_dropdown("leg", LEGS, hint="of a sensor, or of all its valves")
    fail = gui.add_button("fail now", color="red", hint="let it fail in the next frame")

    def push() -> None:
        force = 0.01 * size.value * weight(desk.carried)
        x, y, z = (force * part for part in DIRECTIONS[direction.value])
        desk.apply(Change(push=Push(force=(x, y, z)) if on.value else Push()))

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
    client, gui = desk.client, desk.client.gui
    export = gui.add_button(
        "export scenario", icon="download", hint="`cmf run` repeats this session bit for bit"
    )
    save = gui.add_button(
        "save record", icon="download", hint="the last ten minutes at 128 Hz, as Parquet"
    )

    @export.on_click
    def _(_: Any) -> None:
        text = scenario_toml(desk.live.scenario().result())
        client.send_file_download("session.toml", text.encode("utf-8"), save_immediately=True)

    @save.on_click
    def _(_: Any) -> None:
        try:
            record = desk.live.record().result()
            with tempfile.TemporaryDirectory() as folder:
                content = record.save(Path(folder) / "session.parquet").read_bytes()
            client.send_file_download("session.parquet", content, save_immediately=True)
        except ValueError as error:
            desk.tell(error)
