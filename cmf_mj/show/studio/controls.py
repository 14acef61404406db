"""Controls of a page: run, signal, machine and disturbances."""

import math

import viser

from cmf_mj.facility.scenario.settings import Failure, Push, Scenario, change_of
from cmf_mj.machine import models
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.plant.events import KINDS, default_event
from cmf_mj.plant.parameters.loading import HYDRAULICS
from cmf_mj.show.studio import choices
from cmf_mj.show.studio.desk import Desk, by_hand, picked
from cmf_mj.show.studio.live import View

SPEEDS = {"1": 1.0, "1/2": 0.5, "1/5": 0.2, "1/10": 0.1, "1/50": 0.02}
"""Slow motion: simulated over wall time."""


class RunControls:
    """Pause, reset, slow motion and how the session stands."""

    def __init__(self, desk: Desk) -> None:
        """Add them to the container in force."""
        gui = desk.client.gui
        self._status = gui.add_markdown("starting ...")
        self._buttons = gui.add_button_group("run", ("pause", "go on", "reset"))
        self._speed = gui.add_dropdown(
            "speed", tuple(SPEEDS), initial_value="1", hint="simulated over wall time"
        )
        self._shown = ""

        @self._buttons.on_click
        def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            if event.target.value == "reset":
                desk.again()
            else:
                desk.live.pause(event.target.value == "pause")

        @self._speed.on_update
        def _(event: viser.GuiEvent[viser.GuiDropdownHandle[str]]) -> None:
            if by_hand(event):
                desk.live.set_speed(SPEEDS[event.target.value])

    def show(self, view: View) -> None:
        """Bring the status up to date."""
        live, pace = view.live, view.pace
        lines = [f"**t = {live.time:.1f} s** {'(paused)' if view.paused else ''}"]
        if not math.isnan(pace.capacity):
            lines += [f"real-time factor {pace.capacity:.1f}, paced to {pace.factor:.2f}"]
        if pace.given_up > 0.0:
            lines += [f"too slow: {pace.given_up:.1f} s given up"]
        lines += [f"law {live.law}" + (f", {live.state}" if live.state else "")]
        if live.fault is not None:
            leg = "" if live.fault.leg is None else f" of leg {live.fault.leg}"
            lines += [f"**fault: {live.fault.name.replace('_', ' ')}{leg}**"]
        text = "  \n".join(lines)
        if text != self._shown:
            self._shown = self._status.content = text


class SignalControls:
    """Degree of freedom, kind, amplitude and frequency of the demand."""

    def __init__(self, desk: Desk) -> None:
        """Add them to the container in force."""
        gui = desk.client.gui
        self._desk = desk
        self._dof = gui.add_dropdown("DOF", DOFS, initial_value="heave")
        self._kind = gui.add_dropdown("signal", choices.SIGNALS, initial_value="sine")
        self._amplitude = gui.add_slider("amplitude [in]", 0.05, 41.0, 0.05, 2.0)
        self._frequency = gui.add_slider(
            "frequency [Hz]", 0.05, 10.0, 0.05, 0.5, hint="of a sine, or upper edge of the band"
        )
        for handle in (self._dof, self._kind, self._amplitude, self._frequency):
            handle.on_update(self._moved)
        gui.add_button("send again", hint="step, pulse and chirp once more").on_click(
            lambda _: self.send()
        )

    @property
    def dof(self) -> str:
        """Degree of freedom chosen."""
        return self._dof.value

    def send(self) -> None:
        """Let the signal take over."""
        table = choices.signal_table(
            self._kind.value, self.dof, self._amplitude.value, self._frequency.value
        )
        try:
            self._desk.apply(change_of({"signal": table}, "signal"))
        except ValueError as error:
            self._desk.tell(error)

    def sync(self, scenario: Scenario) -> None:
        """Show the signal of a scenario, where the page has such a one."""
        signals = scenario.signal
        if not signals:
            self._kind.value = "rest"
        if len(signals) != 1 or signals[0].kind not in choices.SIGNALS:
            return
        table = signals[0].model_dump()
        self._dof.value = table["dof"]
        self._limit()
        self._kind.value = table["kind"]
        value, unit = table["amplitude"]
        if unit == dof_unit(self.dof):
            self._amplitude.value = value
        self._frequency.value = table.get("frequency", table.get("stop", self._frequency.value))

    def _moved(self, event: viser.GuiEvent[viser.GuiInputHandle[str]]) -> None:
        if by_hand(event):
            if event.target is self._dof:
                self._limit()
            self._desk.later("signal", self.send)

    def _limit(self) -> None:
        """Scale the amplitude to the degree of freedom."""
        largest = choices.largest_amplitude(self.dof)
        self._amplitude.label = f"amplitude [{dof_unit(self.dof)}]"
        self._amplitude.max = largest
        self._amplitude.value = min(self._amplitude.value, largest)


class MachineControls:
    """Cab, plant set and protection: each begins a new run."""

    def __init__(self, desk: Desk) -> None:
        """Add them to the container in force."""
        gui = desk.client.gui
        self._cab = gui.add_dropdown("cab", models.CABS)
        self._hydraulics = gui.add_dropdown("plant set", HYDRAULICS, initial_value="hardware")
        self._protection = gui.add_checkbox(
            "protection", False, hint="fault detection that makes an emergency stop"
        )
        gui.add_markdown("*A change here begins a new run.*")

        def moved(event: viser.GuiEvent[viser.GuiInputHandle[str]]) -> None:
            if by_hand(event):
                desk.again(
                    cab=self._cab.value,
                    hydraulics=self._hydraulics.value,
                    protection="default" if self._protection.value else None,
                )

        for handle in (self._cab, self._hydraulics, self._protection):
            handle.on_update(moved)

    def sync(self, scenario: Scenario) -> None:
        """Show the machine of a scenario."""
        self._cab.value = scenario.cab
        picked(self._hydraulics, scenario.hydraulics)
        self._protection.value = scenario.protection is not None


class DisturbanceControls:
    """A push on the platform, and failures."""

    def __init__(self, desk: Desk) -> None:
        """Add them to the container in force."""
        gui = desk.client.gui
        self._direction = gui.add_dropdown("push", tuple(choices.DIRECTIONS))
        self._size = gui.add_slider("force [kN]", 1.0, choices.LARGEST_PUSH, 1.0, 20.0)
        self._on = gui.add_checkbox("push now", False, hint="lasts until it is switched off")
        self._kind = gui.add_dropdown("failure", KINDS, initial_value="pump_lost")
        self._leg = gui.add_dropdown("leg", tuple("123456"), hint="of a valve or sensor")
        self._desk = desk
        for handle in (self._direction, self._size, self._on):
            handle.on_update(self._moved)
        gui.add_button("fail now", color="red").on_click(lambda _: self._fail())

    def sync(self, scenario: Scenario) -> None:
        """A new run begins without a push."""
        self._on.value = False

    def _moved(self, event: viser.GuiEvent[viser.GuiInputHandle[bool]]) -> None:
        if by_hand(event) and (self._on.value or event.target is self._on):
            self._desk.later("push", self._push)

    def _push(self) -> None:
        force = choices.push_of(self._direction.value, self._size.value)
        self._desk.apply(
            change_of({}).model_copy(update={"push": force if self._on.value else Push()})
        )

    def _fail(self) -> None:
        event = default_event(self._kind.value, 0.0)
        leg = None if event.leg is None else int(self._leg.value)
        failure = Failure(kind=event.kind, leg=leg)
        self._desk.apply(change_of({}).model_copy(update={"failure": (failure,)}))
