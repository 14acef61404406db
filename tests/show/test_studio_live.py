"""The studio without a browser: real time in parts, what the controls mean, sessions."""

import re
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from pathlib import Path
from signal import SIGINT, SIGTERM, Signals
from types import SimpleNamespace
from typing import Any, cast

import matplotlib.image
import numpy as np
import pytest
from hostile import random_change
from lengths import examples
from shared import cmf

from cmf_mj import InputError, RunError
from cmf_mj.control.law import law_names
from cmf_mj.control.protection import Fault
from cmf_mj.core.settings import parsed_toml, read_toml
from cmf_mj.facility.run import Run, SignalSession
from cmf_mj.facility.scenario import scenario_of, scenario_toml
from cmf_mj.facility.settings import Change, change_of
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.events import KINDS
from cmf_mj.show.stage import UNITS
from cmf_mj.show.studio import controls, desk
from cmf_mj.show.studio.desk import session_page
from cmf_mj.show.studio.live import (
    KEPT_ROWS,
    LARGEST,
    LONGEST,
    PLOT_RATE,
    Clock,
    LiveSession,
    View,
    marks_of,
    words,
)
from cmf_mj.show.studio.plots import Plots, lamp, spikes

SHORT = {"duration": 1.0, "record_every": 16}


def heave(**settings: object) -> Run:
    signal = desk.signal_table("sine", "heave", 2.0, frequency=2.0)
    return scenario_of({"signal": signal, **SHORT, **settings}, "test")


class Screen:
    """Keeps what a session shows."""

    def __init__(self) -> None:
        self.views: list[View] = []
        self.errors: list[Exception] = []
        self.reached = threading.Condition()

    def show(self, view: View) -> None:
        with self.reached:
            self.views.append(view)
            self.reached.notify_all()

    def tell(self, error: Exception) -> None:
        with self.reached:
            self.errors.append(error)
            self.reached.notify_all()

    def wait(self, condition: Callable[[], object]) -> None:
        with self.reached:
            assert self.reached.wait_for(condition, timeout=60.0)

    def wait_for_time(self, seconds: float) -> None:
        self.wait(lambda: self.views and self.views[-1].live.time >= seconds)

    def session(self, scenario: Run) -> LiveSession:
        """A session that goes on until the test ends."""
        self.opened = LiveSession(scenario, self.show, self.tell)
        self.opened.start()
        return self.opened


@pytest.fixture
def screen() -> Iterator[Screen]:
    screen = Screen()
    yield screen
    if hasattr(screen, "opened"):
        screen.opened.close()


# Real time.


def test_clock_owes_every_frame_once() -> None:
    clock = Clock(5.0)
    turns = [clock.due(5.0 + 0.0371 * k) for k in range(1, 100)]
    assert sum(turns) == int(0.0371 * 99 * 2048)
    assert clock.pace.given_up == 0.0


def test_clock_runs_slow_motion_and_stands_still_when_paused() -> None:
    clock = Clock(0.0)
    clock.speed = 0.1
    assert sum(clock.due(0.1 * k) for k in range(1, 21)) == pytest.approx(0.2 * 2048, abs=1)
    clock.paused = True
    assert clock.due(2.2) == 0
    clock.paused = False
    assert clock.due(2.3) == pytest.approx(0.01 * 2048, abs=1)  # the pause is not owed


def test_clock_counts_what_it_gives_up() -> None:
    clock = Clock(0.0)
    assert clock.due(3.0) == int(LARGEST * 2048)
    assert clock.pace.given_up == pytest.approx(3.0 - LARGEST)


def test_pace_is_simulated_over_wall_and_over_busy_time() -> None:
    clock = Clock(0.0)
    for _ in range(100):
        clock.ran(wall=0.05, frames=64, busy=0.01)
    assert clock.pace.factor == pytest.approx(64 / 2048 / 0.05)
    assert clock.pace.capacity == pytest.approx(64 / 2048 / 0.01)


# What the controls mean.


@pytest.mark.parametrize("dof", DOFS)
@pytest.mark.parametrize("kind", ["rest", *desk.SIGNALS])
def test_every_signal_of_the_page_can_be_run(kind: str, dof: str) -> None:
    offered = desk.signal_settings(kind)
    for frequency in (0.05, 10.0):
        edges = {"frequency": frequency, "start": 0.5 * frequency, "stop": frequency}
        settings = {name: edges.get(name, begun) for name, begun in offered.items()}
        if kind == "multisine":
            settings["start"] = 0.05  # the lowest line of its period
        largest = desk.largest_amplitude(dof)
        change = change_of({"signal": desk.signal_table(kind, dof, largest, **settings)})
        assert change.signal is not None
        assert len(change.signal) == (0 if kind == "rest" else 1)
        for signal in change.signal:
            poses = signal.motion(0)(np.arange(4096))
            assert np.isfinite(poses).all()
            others = np.delete(poses, DOFS.index(dof), axis=1)
            assert not others.any()


def test_the_page_offers_the_settings_of_the_signals() -> None:
    assert list(desk.SIGNALS) == [
        *("step", "pulse", "sine", "chirp", "noise", "multisine", "seven_sines")
    ]
    assert desk.signal_settings("rest") == {}
    assert desk.signal_settings("sine") == {"frequency": 0.5, "fade": 1.0, "rest": 0.0}
    assert desk.signal_settings("noise")["scale"] == "peak"
    (table,) = desk.signal_table("pulse", "roll", 3.0, width=2.0)
    expected = {"kind": "pulse", "dof": "roll", "amplitude": [3.0, "deg"], "at": 1.0, "width": 2.0}
    assert table == expected


def test_a_run_from_rest_keeps_law_gains_and_signal_and_drops_the_rest() -> None:
    step = desk.signal_table("step", "yaw", 1.0)
    scenario = heave(
        change=[
            {"at": 0.1, "law": "force", "gains": {"direct_gain": {"force": -0.02}}},
            {"at": 0.2, "gains": {"direct_gain": {"reference": 40.0}}},
            {"at": 0.3, "signal": step, "push": {"force": [1.0, 0.0, 0.0]}},
            {"at": 0.4, "failure": [{"kind": "pump_lost"}]},
        ]
    )
    begun = desk.from_rest(scenario)
    assert begun.law == "force"
    assert begun.gains == {"direct_gain": {"force": -0.02, "reference": 40.0}}
    assert [signal.kind for signal in begun.signal] == ["step"]
    assert begun.change == () and begun.events == () and begun.duration == "open"
    pump = desk.ready_scenarios()["pump_failure"]
    assert desk.from_rest(pump).events == pump.events != ()


@pytest.mark.parametrize("machine", ["cmf", "simona", "lab"])
def test_a_machine_s_own_law_is_listed_by_name_and_can_be_chosen_again(machine: str) -> None:
    begun = scenario_of({"machine": machine, **SHORT}, "test")
    name = desk.law_of(begun)
    assert name == {"cmf": "velocity"}.get(machine, f"{machine}_plan")
    session = SignalSession(begun)
    session.apply(Change(law="force"))
    session.run(64)
    session.apply(Change(law=name))
    session.run(64)
    assert session.look().law == name


# Sessions.


def test_session_goes_with_the_wall_clock_and_its_scenario_repeats_it(screen: Screen) -> None:
    session = screen.session(heave())
    screen.wait_for_time(0.5)
    session.apply(change_of({"law": "position_error_rate"})).result()
    session.apply(change_of({"signal": desk.signal_table("step", "roll", 1.0)})).result()
    session.apply(change_of({"push": {"force": [2e4, 0.0, 0.0]}})).result()
    screen.wait_for_time(1.5)
    session.apply(change_of({"gains": {"direct_gain": {"velocity": -0.5}}})).result()
    session.apply(change_of({"failure": [{"kind": "valve_dead", "leg": 2}]})).result()
    screen.wait_for_time(2.2)
    session.pause(True)
    scenario, record = session.scenario().result(), session.record().result()
    session.close()
    assert not session._thread.is_alive() and not screen.errors
    assert len(scenario.change) == 5
    again = scenario.record()
    assert set(again.channels) == set(record.channels)
    for name, values in record.channels.items():
        assert np.array_equal(again[name][: values.shape[0]], values), name
    assert again.time.size >= record.time.size > 2.2 * 128
    assert np.linalg.norm(screen.views[-1].push) == pytest.approx(2e4)
    past = session._past  # never grows
    assert past.maxlen == round(LONGEST * PLOT_RATE)
    times = np.array([live.time for live in past])
    assert times.size > 2.1 * PLOT_RATE
    np.testing.assert_allclose(np.diff(times), 1.0 / PLOT_RATE, rtol=1e-9)


def test_second_law_does_the_same_from_the_same_start(screen: Screen) -> None:
    """With the first one's law its numbers are the first one's; with another they are not."""
    session = screen.session(heave())
    for beside, same in (("velocity", True), ("force", False)):
        session.begin(heave(), beside).result()
        session.apply(change_of({"push": {"force": [2e4, 0.0, 0.0]}})).result()
        screen.wait_for_time(0.5)
        session.pause(True)
        session.scenario().result()
        pairs = [(a, b) for a, b in zip(session._past, session._beside_past, strict=True) if b]
        assert len(pairs) == len(session._past) > 0.4 * PLOT_RATE
        assert np.array_equal(pairs[-1][0].qpos, pairs[-1][1].qpos) == same
        session.pause(False)
        screen.views.clear()
    session.apply(change_of({"law": "position_error_rate"})).result()
    screen.wait_for_time(session._past[-1].time + 0.1)
    assert session._beside is not None and session._beside.look().law == "force"
    with pytest.raises(InputError, match="nobody"):
        session.begin(heave(), "nobody").result()
    session.close()
    assert not screen.errors


def test_all_that_happens_is_marked() -> None:
    scenario = heave(
        duration=10.0,
        event=[{"at": 2.0, "kind": "valve_dead", "leg": 2}],
        change=[
            {"at": 1.0, "law": "force", "gains": {"direct_gain": {"force": -0.02}}},
            {"at": 3.0, "push": {"force": [1.0, 0.0, 0.0]}},
            {"at": 4.0, "push": {}, "failure": [{"kind": "pump_lost"}]},
        ],
    )
    marks = marks_of(scenario, Fault("following_error", 2, 5 * 2048))
    assert marks == (
        (1.0, "law force, gain", False),
        (2.0, "valve dead of leg 2, all its valves", True),
        (3.0, "push", False),
        (4.0, "pump lost", True),
        (4.0, "push ends", False),
        (5.0, "tripped: following error of leg 2", True),
    )
    changed, harm = spikes(np.arange(3.5, 10.0, 0.25), marks)
    assert np.flatnonzero(changed > 0.0).tolist() == [2]
    assert np.flatnonzero(harm > 0.0).tolist() == [2, 6]


def test_lamp_tells_what_failed_and_what_tripped(screen: Screen) -> None:
    guarded = heave(protection="default", change=[{"at": 0.1, "failure": [{"kind": "pump_lost"}]}])
    session = screen.session(guarded)
    screen.wait(lambda: screen.views and screen.views[-1].live.fault is not None)
    session.close()
    lamps = [lamp(view) for view in screen.views]
    words = [
        next(w for w in ("all works", "tripped", "failed") if f"<b>{w}" in one) for one in lamps
    ]
    order = [word for number, word in enumerate(words) if word not in words[:number]]
    assert order == ["all works", "failed", "tripped"]
    assert "0.1 s: pump lost" in lamps[-1]
    late = screen.views[0]._replace(live=screen.views[0].live._replace(late=True))
    assert "<b>host late" in lamp(late)


@pytest.mark.parametrize("name", desk.ready_scenarios())
def test_every_ready_scenario_goes_on_in_a_session(name: str, screen: Screen) -> None:
    session = LiveSession(desk.ready_scenarios()[name], screen.show, screen.tell)
    session._run.run(256)
    assert session._run.look().time == 0.125


LESSONS = read_toml(Path(controls.__file__).with_name("lessons.toml"))


@pytest.mark.parametrize(
    ("prompt", "change", "top"),
    [
        (0, {}, 2.0),
        (1, {"law": "velocity"}, 1.5),
        (2, {"law": "velocity", "dof": "heave"}, 1.14),
        (3, {"law": "modal_plan"}, 1.0),
    ],
)
def test_what_the_lesson_on_surge_says_is_seen(
    prompt: int, change: dict[str, str], top: float
) -> None:
    law, dof = change.get("law", "position_error_rate"), change.get("dof", "surge")
    step = desk.signal_table("step", dof, 1.0)
    record = scenario_of({"law": law, "signal": step, "duration": 4.0}, "test").record()
    response = record["platform_pose"][:, DOFS.index(dof)] / 0.0254
    assert response.max() == pytest.approx(top, abs=0.05)
    peaks = record.time[1:-1][(np.diff(response)[:-1] > 0) & (np.diff(response)[1:] <= 0)]
    swings = peaks[peaks > 1.1]
    answer = LESSONS["surge_ring"][prompt]["answer"]
    if dof == "surge" and law != "modal_plan":
        assert 1.0 / np.diff(swings)[:4].mean() == pytest.approx(3.0, abs=0.2)
    else:
        assert (response[record.time > 1.6] < 1.03).all()
    if prompt == 0:
        assert "twice the step, three times a second" in answer
    if prompt in (1, 2):
        assert {1: "to about 1.5 times the step, but as fast", 2: "overshoot of 14 %"}[
            prompt
        ] in answer


def test_what_the_lesson_on_the_pump_says_is_seen() -> None:
    record = desk.ready_scenarios()["pump_failure"].record()
    tripped = record.metadata["fault"]["time"]
    pressure = record["supply_pressure"].ravel()[record.time.searchsorted(tripped)]
    assert tripped - 4.0 == pytest.approx(6.0, abs=0.3)
    assert pressure == pytest.approx(1000 * 6894.76, rel=0.02)
    assert "Near 1000 psi (70 bar), about six seconds" in LESSONS["pump_failure"][1]["answer"]


def test_lessons_are_of_ready_scenarios_and_wait_for_what_can_happen() -> None:
    happens = {"", "signal", "tripped", *(f"law {name}" for name in law_names("all"))}
    happens |= {words(kind, None) for kind in KINDS}
    for name, prompts in LESSONS.items():
        assert name in desk.ready_scenarios()
        assert all(set(prompt) == {"ask", "until", "answer"} for prompt in prompts)
        assert {prompt["until"] for prompt in prompts} <= happens
        for link in re.findall(r"\?scenario=(\w+)", str(prompts)):
            assert link in desk.ready_scenarios()


def test_a_prompt_is_never_beyond_the_last_however_often_the_button_is_pressed() -> None:
    pressed: list[Callable[[object], None]] = []
    followers: list[Callable[[Run], None]] = []

    def add(*_: object, **given: object) -> SimpleNamespace:
        return SimpleNamespace(**given, on_click=pressed.append, on_update=lambda _: None)

    def add_dropdown(*_: object, **__: object) -> SimpleNamespace:
        return SimpleNamespace(options=(), value="", on_update=lambda _: None)

    gui = SimpleNamespace(add_markdown=add, add_button=add, add_dropdown=add_dropdown)
    live = SimpleNamespace(marks=lambda: SimpleNamespace(result=lambda: ()))
    studio = SimpleNamespace(client=SimpleNamespace(gui=gui), live=live, follow=followers.append)
    show = controls.scenario_controls(cast(Any, studio))
    view = cast(Any, SimpleNamespace(marks=(), live=SimpleNamespace(time=0.0)))
    for name in ("surge_ring", "pump_failure", "push"):
        followers[0](desk.ready_scenarios()[name])
        for _ in range(9):
            pressed[0](None)
            show(view)


@pytest.mark.parametrize("beside", ["", "force"])
def test_plots_draw_numbers_alone(beside: str, screen: Screen) -> None:
    """A gap would have no scale. The second line is the first one's without a second law."""
    drawn: list[SimpleNamespace] = []

    def add_uplot(*_: object, **given: object) -> SimpleNamespace:
        drawn.append(SimpleNamespace(**given, data=()))
        return drawn[-1]

    plots = Plots(cast(Any, SimpleNamespace(gui=SimpleNamespace(add_uplot=add_uplot))))
    session = LiveSession(heave(), screen.show, screen.tell)
    session.begin(heave(), beside)
    session.start()
    screen.wait_for_time(0.5)
    session.pause(True)
    session.scenario().result()
    waiting = screen.views[-1]._replace(past=[], beside=[])
    plots.show(waiting, 10.0, "heave", "US", 2)  # nothing is left of a run before
    assert all(len(line) == 2 for plot in drawn if plot.visible for line in plot.data)
    for dof, system in zip(("heave", ""), UNITS, strict=True):  # nothing else moves
        plots.show(screen.views[-1], 10.0, dof, system, 2)
    session.close()
    of = {plot.title: plot for plot in drawn}
    for shown, hidden, factor in (
        ("platform, heave [mm]", "platform, heave [in]", 25.4),
        ("manifolds [bar]", "manifolds [psi]", 0.0689476),
    ):
        assert of[shown].visible and not of[hidden].visible
        np.testing.assert_allclose(of[shown].data[1], factor * of[hidden].data[1], rtol=1e-6)
    lines = [line for plot in drawn for line in plot.data]
    assert len(lines) > 20 and np.isfinite(np.concatenate(lines)).all()
    _, demand, second, response, *_ = next(
        plot.data for plot in drawn if "heave [in]" in plot.title
    )
    assert np.ptp(response) > 0.1 and not np.array_equal(demand, response)
    assert np.array_equal(second, response) == (not beside)


def test_page_of_a_session_begins_where_the_record_does_and_says_what_happened(
    tmp_path: Path,
) -> None:
    """Of a long session only the end is kept."""
    session = SignalSession(heave(), keep=0.25)
    session.run(256)
    session.apply(Change(law="force"))
    session.run(768)
    record, marks = session.record(), marks_of(session.done(), None)
    text = session_page(record, tmp_path / "x.html", marks, "metric").read_text("utf-8")
    assert "<title>velocity, 0.1 s: law force</title>" in text
    assert "heave [mm]: response" in text and "[bar]: supply" in text
    assert f"from {record.time[0]:g} to" in text and record.time[0] == 0.25


def test_session_tells_when_the_state_leaves_its_bounds_and_begins_again(screen: Screen) -> None:
    crushed = heave(change=[{"at": 0.1, "push": {"force": [0.0, 0.0, -1e7]}}])
    session = screen.session(crushed)
    screen.wait(lambda: screen.errors)
    assert "leg_" in str(screen.errors[0])
    session.begin(heave()).result()
    ended = len(screen.views)
    screen.wait(lambda: len(screen.views) > ended + 3 and screen.views[-1].live.time > 0.1)


def test_session_refuses_and_goes_on(screen: Screen) -> None:
    session = screen.session(heave())
    with pytest.raises(ValueError, match="plant: 'single_legs'"):
        session.begin(heave(plant="single_legs")).result()
    with pytest.raises(ValueError, match="body: 'roof' is not one of"):
        session.apply(change_of({"push": {"body": "roof"}})).result()
    screen.wait_for_time(0.2)


def test_session_that_has_ended_answers_nobody_and_keeps_nobody_waiting(screen: Screen) -> None:
    session = screen.session(heave())
    screen.wait_for_time(0.05)
    session.close()
    with pytest.raises(CancelledError):
        session.record().result(timeout=10.0)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_session_that_a_defect_ends_keeps_nobody_waiting(screen: Screen) -> None:
    """Whoever asked before it ended, and whoever asks after."""

    def broken(view: object) -> None:
        raise TypeError("no picture")

    session = LiveSession(heave(), broken, screen.tell)
    waiting = session.record()
    session.start()
    waiting.result(timeout=60.0)
    session._thread.join(60.0)
    assert [type(error) for error in screen.errors] == [TypeError]
    with pytest.raises(CancelledError):
        session.record().result(timeout=10.0)


def test_session_goes_on_when_a_caller_no_longer_waits(screen: Screen) -> None:
    session = LiveSession(heave(), screen.show, screen.tell)
    assert session.record().cancel()
    session.start()
    screen.wait_for_time(0.05)
    session.scenario().result(timeout=60.0)
    session.close()
    assert not screen.errors


@pytest.mark.fuzz
@pytest.mark.parametrize("seed", range(examples(5)))
def test_session_answers_whoever_asks_whatever_is_asked(seed: int, screen: Screen) -> None:
    """Random changes, good and bad, at random moments: each is done or refused, in time."""
    draw, asked = np.random.default_rng(seed), list[Future[Any]]()
    chain = heave(operation={"begin": "settled"}, protection="default")
    session = screen.session(chain)
    session.set_speed(4.0)
    for _ in range(60):
        time.sleep(float(draw.uniform(0.0, 0.03)))
        choice = draw.random()
        if choice < 0.1:
            asked.append(session.begin(chain if choice < 0.08 else heave(plant="single_legs")))
        elif choice < 0.2:
            asked.append(session.record())
        elif choice < 0.3:
            asked.append(session.scenario())
        elif choice < 0.4:
            session.pause(choice < 0.33)
        else:
            try:
                asked.append(session.apply(change_of(random_change(draw, chain=True))))
            except InputError as error:
                assert str(error).startswith("change")
    refused = [one.exception(timeout=60.0) for one in asked]
    assert all(error is None or isinstance(error, InputError) for error in refused)
    assert session._thread.is_alive()
    session.close()
    assert all(isinstance(error, RunError) for error in screen.errors)


def test_session_keeps_a_bounded_record() -> None:
    screen = Screen()
    session = LiveSession(heave(record_every=1), screen.show, screen.tell)
    assert session._run.parts[3].out.shape[0] <= KEPT_ROWS


# The command.


@pytest.mark.parametrize("number", [SIGINT, SIGTERM])
def test_command_serves_on_this_machine_alone_and_ends_when_told(
    tmp_path: Path, number: Signals
) -> None:
    scenario = tmp_path / "mine.toml"
    scenario.write_text('law = "force"\nduration = "open"\n')
    command = [sys.executable, "-m", "cmf_mj", "studio", str(scenario), "--no-open"]
    with subprocess.Popen(
        [*command, "--port", "8460"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        line = next(line for line in process.stdout if line.startswith("studio: "))
        url = line.split()[1]
        assert url.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(url, timeout=30.0) as reply:
            assert b"<html" in reply.read(2000)
        process.send_signal(number)
        try:
            assert process.wait(timeout=60.0) == 0
        finally:
            process.kill()
        assert process.stderr is not None and "Traceback" not in process.stderr.read()


def test_command_refuses_a_bad_scenario_by_its_key(tmp_path: Path) -> None:
    scenario = tmp_path / "bad.toml"
    scenario.write_text('cabin = "gfd"\n')
    assert "cabin: is not a known field" in cmf("studio", scenario, "--no-open", code=2)


def test_command_names_the_extra_where_viser_is_missing() -> None:
    code = (
        "import sys; sys.modules['viser'] = None\n"
        "from cmf_mj.cli import main\n"
        "sys.argv = ['cmf', 'studio', '--no-open']\n"
        "main()\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 2
    assert "pip install 'cmf-mj[studio]'" in result.stderr


def test_first_scenario_is_a_file_too() -> None:
    begun = desk.ready_scenarios()["studio"]
    assert scenario_of(parsed_toml(scenario_toml(begun), "again"), "again") == begun


@pytest.mark.slow
def test_script_draws_the_page(tmp_path: Path) -> None:
    path = tmp_path / "studio.png"
    command = [sys.executable, "scripts/figures.py", "studio", "--out", str(path), "--seconds", "1"]
    result = subprocess.run(
        [*command, "--port", "8471"], timeout=180.0, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    picture = matplotlib.image.imread(path)
    assert picture.shape[:2] == (900, 1440)
    assert picture[..., :3].std() > 0.05
