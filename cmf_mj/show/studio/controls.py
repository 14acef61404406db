"""Controls of a page.

Each function adds one folder of the page and returns what the page asks of it later.
"""

import math
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import viser

from cmf_mj.control.law import law_names
from cmf_mj.core import units
from cmf_mj.core.settings import read_toml
from cmf_mj.facility.host.stream import write_stream
from cmf_mj.facility.run import Run
from cmf_mj.facility.scenario import scenario_toml
from cmf_mj.facility.settings import Change, Push, change_of
from cmf_mj.facility.signal import HostFile
from cmf_mj.machine import models
from cmf_mj.machine.geometry import DOFS, by_kind, dof_unit
from cmf_mj.pilot.cueing import cue
from cmf_mj.pilot.flight import all_flight_names, load_flight
from cmf_mj.pilot.washout_settings import WASHOUTS
from cmf_mj.plant.events import KINDS, default_event
from cmf_mj.plant.parameters import HYDRAULICS, hydraulics_of
from cmf_mj.record.record import Record
from cmf_mj.show.stage import UNITS
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
    session_page,
    signal_settings,
    signal_table,
    weight,
)
from cmf_mj.show.studio.live import KEPT_ROWS, View
from cmf_mj.show.studio.plots import lamp
from cmf_mj.signals.signal import SingleSignal

SPEEDS = {"1": 1.0, "1/2": 0.5, "1/5": 0.2, "1/10": 0.1, "1/50": 0.02}
"""Slow motion: simulated over wall time."""
LEGS = tuple("123456")  #: Of a hexapod; the page has no other plant.
_HERTZ = ("frequency", "start", "stop", "corner")
"""Settings of signals in Hz; numbers with a point among the others are in s."""

NONE = "none"  #: Choice of no second law, and of no flight.
_cueing = threading.Lock()  #: One flight is made at a time, of all tabs.
CUED = Path("out/studio")  #: Folder of the frames of flights, which exported scenarios name.
_WATCHED = 3.0  #: Time from what a prompt asks for to its answer [s].
_FADE = 3.0  #: Time in which a flight takes over [s]: it begins at neutral.


@dataclass
class Lesson:
    """Prompts of a scenario, one after the other."""

    prompts: list[dict[str, str]]
    index: int = 0  #: Of the prompt that is shown.
    marks_before: int = 0  #: Marks of the run when it was shown.
    answered: set[int] = field(default_factory=set)  #: Prompts, whatever runs begin after.

    @property
    def last(self) -> bool:
        """Whether no other prompt follows."""
        return self.index + 1 >= len(self.prompts)

    def text(self, view: View) -> str:
        """The prompt, and its answer some seconds after what it asks for; empty without one."""
        if not self.prompts:
            return ""
        index, watched = self.index, view.live.time - _WATCHED
        ask, until, answer = (self.prompts[index][key] for key in ("ask", "until", "answer"))
        seen = [mark.text for mark in view.marks[self.marks_before :] if mark.time < watched]
        happened = any(until in text for text in seen) if until else watched > 0.0
        if happened:
            self.answered.add(index)
        hidden = "*Answered some seconds after you did it.*"
        answer_line = f"**Answer:** {answer}" if index in self.answered else hidden
        return f"**Lesson, {index + 1} of {len(self.prompts)}.** {ask}\n\n{answer_line}"


def scenario_controls(desk: Desk) -> Callable[[View], None]:
    """The ready scenarios by title; returns the function that shows the prompts of some."""
    gui, ready = desk.client.gui, {run.title: run for run in ready_scenarios().values()}
    chosen = gui.add_dropdown("scenario", tuple(ready), hint="begins it from rest")
    text, onward = gui.add_markdown("", visible=False), gui.add_button("next prompt", visible=False)
    lessons = read_toml(Path(__file__).with_name("lessons.toml"))
    prompts_by_title = {ready_scenarios()[name].title: found for name, found in lessons.items()}
    lesson = Lesson([])

    def follow(scenario: Run) -> None:
        nonlocal lesson
        pick(chosen, ready.setdefault(scenario.title, scenario).title)
        prompts = prompts_by_title.get(scenario.title, [])
        if lesson.prompts is not prompts or lesson.last:  # the last begins the first again
            lesson = Lesson(prompts)
            desk.wait = bool(prompts)
        lesson.marks_before = 0

    def show(view: View) -> None:
        shown = lesson  # the session's thread is here, and `follow` may replace it meanwhile
        text.content = shown.text(view)
        text.visible = bool(shown.prompts)
        onward.visible = shown.index in shown.answered and not shown.last

    def go_on(_: Any) -> None:
        if not lesson.last:  # a button may be pressed twice
            lesson.index += 1
        lesson.marks_before = len(desk.live.marks().result())

    onward.on_click(go_on)
    by_hand(lambda _: desk.begin(ready[chosen.value]), chosen)
    desk.follow(follow)
    return show


def run_controls(desk: Desk) -> Callable[[View], None]:
    """Buttons of the run; returns the function that shows its state."""
    gui = desk.client.gui
    light = gui.add_html("")
    status = gui.add_markdown("starting ...")
    reset = "reset: from rest, all repaired"
    buttons = gui.add_button_group("run", ("pause", "go on", "reset"), hint=reset)
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
    """The demand; returns the function that gives the degree of freedom and units chosen."""
    gui = desk.client.gui
    system = gui.add_dropdown("units", tuple(UNITS), hint="of the amplitude and the plots")
    dof = gui.add_dropdown("DOF", DOFS, initial_value="heave", hint="which moves and is drawn")
    demand = "demand of the platform; takes over within 1 s"
    kind = gui.add_dropdown("signal", ("rest", *SIGNALS), initial_value="sine", hint=demand)
    amplitude = gui.add_slider("amplitude", 0.05, 41.0, 0.05, 2.0, hint="to the operational limit")
    folder = gui.add_folder("settings")
    settings: dict[str, Any] = {}
    shown = 1.0  # shown units per in or deg

    def size() -> float:
        """The amplitude in in or deg."""
        return round(amplitude.value / shown, 4)

    def send() -> None:
        chosen = {name: handle.value for name, handle in settings.items()}
        table = signal_table(kind.value, dof.value, size(), **chosen)
        desk.apply(change_of({"signal": table}, "signal"))
        for take_over in desk.on_demand:
            take_over()

    def show_amplitude(chosen: float) -> None:
        """Show an amplitude [in or deg] and its limit in the units of the page."""
        nonlocal shown
        largest = largest_amplitude(dof.value, desk.carried.machine.name)
        unit = by_kind(dof.value, *UNITS[system.value][:2])
        shown = units.from_si(unit, units.to_si(dof_unit(dof.value), 1.0))
        amplitude.label, amplitude.max = f"amplitude [{unit}]", round(shown * largest, 1)
        amplitude.value = round(shown * min(chosen, largest), 2)

    def on_change(handle: Any) -> None:
        if handle in (dof, system):
            show_amplitude(size())
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
        show_amplitude(begun)
        show_settings(chosen)

    def show_settings(chosen: dict[str, Any]) -> None:
        """One control for each setting of the kind, by its type."""
        for handle in settings.values():
            handle.remove()
        settings.clear()
        for name, begun in signal_settings(kind.value).items():
            with folder:
                settings[name] = _setting(desk, kind.value, name, chosen.get(name, begun))
        by_hand(on_change, *settings.values())

    by_hand(on_change, system, dof, kind, amplitude)
    again = gui.add_button("send again", hint="step, pulse and chirp once more")
    again.on_click(lambda _: desk.later("signal", send))
    desk.follow(follow)
    return lambda: (dof.value, system.value)


def _setting(desk: Desk, kind: str, name: str, value: Any) -> Any:
    """A control for a setting of a signal."""
    if isinstance(value, str):
        options = get_args(SIGNALS[kind].model_fields[name].annotation)
        return desk.client.gui.add_dropdown(name, options, initial_value=value)
    unit = "Hz" if name in _HERTZ else "s"
    label, step = (name, 1) if isinstance(value, int) else (f"{name} [{unit}]", 0.05)
    return desk.client.gui.add_number(label, value, step=step)


def cueing_controls(desk: Desk) -> Callable[[], bool]:
    """A flight through a washout as the demand; returns the function that says if there is one."""
    gui = desk.client.gui
    flown = gui.add_dropdown(
        "flight", (NONE, *all_flight_names()), hint="of aircraft or car; from its start"
    )
    washout = gui.add_dropdown("washout", WASHOUTS, hint="makes motion of it within the limits")
    sent = (NONE, "")

    def send(handle: Any) -> None:
        """Let a flight take over, unless another choice has been made meanwhile."""
        nonlocal sent
        with _cueing:
            chosen = flown.value, washout.value
            if chosen == sent or (flown.value == NONE and handle is washout):
                return
            signals = host_signals(*chosen)
            if signals is not None and chosen == (flown.value, washout.value):
                sent = chosen
                desk.apply(change_of({"signal": signals, "fade": _FADE}, "signal"))

    def host_signals(flight: str, washout_name: str) -> list[dict[str, str]] | None:
        """Signals of a file of host frames, none to rest; None where they are refused."""
        if flight == NONE:
            return []
        expect = "is being computed: some ten seconds, the first time half a minute"
        note = desk.client.add_notification(f"{flight}, {washout_name}", expect, loading=True)
        try:
            cued = cue(load_flight(flight).motion, washout_name, cab=desk.carried)
            name = f"{flight}-{washout_name}-{desk.carried.machine.name}-{desk.carried.name}.csv"
            file = write_stream(cued.stream, CUED.resolve() / name)
            return [{"kind": "host", "file": str(file)}]
        except (ValueError, OSError) as error:
            desk.tell(error)
            return None
        finally:
            note.remove()

    def forget_flight() -> None:
        nonlocal sent
        flown.value, sent = NONE, (NONE, "")

    def follow(scenario: Run) -> None:
        if not any(isinstance(signal, HostFile) for signal in scenario.signal):
            forget_flight()

    desk.on_demand.append(forget_flight)
    by_hand(send, flown, washout)
    desk.follow(follow)
    return lambda: flown.value != NONE


def law_controls(desk: Desk) -> None:
    """The law, and that of a second machine."""
    gui, laws = desk.client.gui, law_names("all")
    chosen = gui.add_dropdown("law", laws, initial_value="velocity", hint="takes over in motion")
    beside = "a second machine with this law does the same, drawn beside; begins a new run"
    second = gui.add_dropdown("second law", (NONE, *laws), hint=beside)

    def compare(_: Any) -> None:
        desk.beside = "" if second.value == NONE else second.value
        desk.again()

    by_hand(lambda _: desk.apply(Change(law=chosen.value)), chosen)
    by_hand(compare, second)
    desk.follow(lambda scenario: pick(chosen, law_of(scenario)))


def machine_controls(desk: Desk) -> None:
    """Cab, plant set and protection: each begins a new run."""
    gui = desk.client.gui
    cab = gui.add_dropdown("cab", models.CABS, hint="its mass, inertia and centre of mass")
    hydraulics = gui.add_dropdown(
        "plant set", HYDRAULICS, initial_value="hardware", hint="oil, valves, leakage and supply"
    )
    protection = gui.add_checkbox("protection", False, hint="makes an emergency stop at a fault")
    gui.add_markdown("*A change here begins a new run.*")

    def on_change(_: Any) -> None:
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

    by_hand(on_change, cab, hydraulics, protection)
    desk.follow(follow)


def disturbance_controls(desk: Desk) -> None:
    """A push on the platform, and failures."""
    gui = desk.client.gui
    direction = gui.add_dropdown("push", tuple(DIRECTIONS), hint="force on the centre of mass")
    size = gui.add_slider("force [%]", 1.0, LARGEST_PUSH, 1.0, 15.0, hint="of the weight")
    on = gui.add_checkbox("push now", False, hint="lasts until it is switched off")
    kind = gui.add_dropdown("failure", KINDS, initial_value="pump_lost", hint="lasts until a reset")
    leg = gui.add_dropdown("leg", LEGS, hint="of a sensor, or of all its valves")
    fail = gui.add_button("fail now", color="red", hint="let it fail in the next frame")

    def push() -> None:
        force = 0.01 * size.value * weight(desk.carried)
        x, y, z = (force * part for part in DIRECTIONS[direction.value])
        desk.apply(Change(push=Push(force=(x, y, z)) if on.value else Push()))

    def on_change(handle: Any) -> None:
        if on.value or handle is on:
            desk.later("push", push)

    @fail.on_click
    def _(_: Any) -> None:
        needs_leg = default_event(kind.value, 0.0).leg is not None
        failure = {"kind": kind.value, "leg": int(leg.value) if needs_leg else None}
        desk.apply(change_of({"failure": [failure]}))

    by_hand(on_change, direction, size, on)
    desk.follow(lambda _: setattr(on, "value", False))  # a new run begins without a push


def file_controls(desk: Desk, shown: Callable[[], tuple[str, str]]) -> None:
    """The session as a scenario, its record, and a page that plays it in the units shown."""
    client, gui = desk.client, desk.client.gui
    export = gui.add_button("export scenario", icon="download", hint="`cmf run` repeats it")
    save = gui.add_button("save record", icon="download", hint=f"its last {KEPT_ROWS} rows")
    page = gui.add_button("save page", icon="download", hint="the session as a page that plays it")

    @export.on_click
    def _(_: Any) -> None:
        done = desk.live.scenario().result()
        signals = [*done.signal, *(one for change in done.change for one in change.signal or ())]
        for file in {one.file for one in signals if isinstance(one, HostFile)}:
            client.add_notification(
                "Send this file with the scenario and correct its path",
                file,
                auto_close_seconds=30.0,
            )
        text = scenario_toml(done)
        client.send_file_download("session.toml", text.encode("utf-8"), save_immediately=True)

    def keep(name: str, write: Callable[[Record, Path], Path]) -> None:
        try:
            record = desk.live.record().result()
            with tempfile.TemporaryDirectory() as folder:
                content = write(record, Path(folder) / name).read_bytes()
            client.send_file_download(name, content, save_immediately=True)
        except ValueError as error:
            desk.tell(error)

    def played(record: Record, path: Path) -> Path:
        return session_page(record, path, desk.live.marks().result(), shown()[1])

    save.on_click(lambda _: keep("session.parquet", Record.save))
    page.on_click(lambda _: keep("session.html", played))
