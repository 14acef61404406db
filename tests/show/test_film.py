"""Films: pictures, encoders, and what is said without a display."""

import sys
from pathlib import Path
from typing import Any

import av
import mujoco
import numpy as np
import pytest
from shared import cmf

from cmf_mj import Hexapod, Record, Run
from cmf_mj.core import units
from cmf_mj.core.errors import InputError, MissingExtraError
from cmf_mj.facility import scenario
from cmf_mj.facility.signal import ValveCommands
from cmf_mj.machine.geometry import DOFS, dof_unit
from cmf_mj.plant.hexapod import hexapod_spec
from cmf_mj.show import stage
from cmf_mj.show.film import FilmSettings, film
from cmf_mj.show.look import Curve, Panel
from cmf_mj.show.stage import (
    FilmStage,
    Strip,
    busiest_leg,
    choose_backend,
    limits_of,
    traces_of,
)

SMALL = FilmSettings(fps=10, width=160, height=100, strip=140)


def quick(**fields: Any) -> scenario.Run:
    sine = {"kind": "sine", "dof": "heave", "amplitude": [6.0, "in"], "frequency": 1.0}
    return scenario.scenario_of({"duration": 0.5, "signal": [sine]} | fields, "test")


@pytest.fixture(scope="module")
def record() -> Record:
    return quick().record()


@pytest.fixture(scope="module")
def single() -> Record:
    return quick(plant="single_legs", record_every=7).record()


# Films


def frames_of(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


@pytest.mark.slow
def test_a_film_of_two_runs_has_real_speed_and_both_in_it(
    record: Record, single: Record, tmp_path: Path
) -> None:
    path = film([record, single], tmp_path / "two.mp4", SMALL, titles=["a", "b"])
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.width, stream.height) == (320, 240)
        assert stream.average_rate == 10
        assert stream.codec_context.name == "h264"
    pictures = frames_of(path)
    assert len(pictures) == 5  # 0.5 s of frames 1/2048 s apart end before the sixth picture
    left, right = pictures[0][:100, :160], pictures[0][:100, 160:]
    assert np.abs(left.astype(int) - right.astype(int)).mean() > 5.0
    moved = np.abs(pictures[-1][:100].astype(int) - pictures[0][:100].astype(int))
    assert moved.max() > 60


def test_slow_motion_has_more_pictures(single: Record, tmp_path: Path) -> None:
    slow = SMALL._replace(speed=0.5, strip=0)
    seen: list[tuple[int, int]] = []
    path = film([single], tmp_path / "slow.mp4", slow, progress=lambda *done: seen.append(done))
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.frames == seen[-1][0] == seen[-1][1] == 10
        assert (stream.width, stream.height) == (160, 100)
        assert stream.average_rate == 10


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"name": "x.avi"}, "out: x.avi must end in .mp4 or .html"),
        ({"width": 8}, "width: 8 pixels must be between 16 and 1920"),
        ({"width": 161}, "width: 161 pixels must be even"),
        ({"camera": "roof"}, "camera: 'roof' is not one of overview, side"),
        ({"speed": 0.0}, "speed, fps: 0.0, 10 must be greater than 0"),
        ({"start": 0.5}, "start: 0.5 s; allowed: from 0 to below 0.49"),
        ({"seconds": 0.0}, "seconds: 0.0 must be greater than 0"),
    ],
)
def test_what_a_film_cannot_do_is_named(
    change: dict[str, Any], said: str, single: Record, tmp_path: Path
) -> None:
    path = tmp_path / change.pop("name", "x.mp4")
    with pytest.raises(ValueError) as refused:  # noqa: PT011
        film([single], path, SMALL._replace(**change))
    assert said in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_a_film_without_its_package_is_refused(
    single: Record, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(
        MissingExtraError, match=r"av is not installed: pip install 'cmf-mj\[video\]'"
    ):
        film([single], tmp_path / "x.mp4", SMALL)


@pytest.mark.slow
def test_a_part_of_a_run_is_filmed_from_its_row_on(record: Record, tmp_path: Path) -> None:
    """From 0.2 to 0.4 s at 10 pictures a second: three pictures, the whole film's third to fifth;
    with the last seconds missing it goes to the end."""
    bare = SMALL._replace(strip=0)
    whole = film([record], tmp_path / "whole.mp4", bare)
    part = film([record], tmp_path / "part.mp4", bare._replace(start=0.2, seconds=0.2))
    rest = film([record], tmp_path / "rest.mp4", bare._replace(start=0.3))
    every, some = frames_of(whole), frames_of(part)
    assert (len(every), len(some), len(frames_of(rest))) == (5, 3, 2)
    for number, picture in enumerate(some):  # each film is compressed by itself
        away = [np.abs(picture.astype(int) - other).mean() for other in every]
        assert int(np.argmin(away)) == number + 2


def test_traces_are_the_record_s(record: Record) -> None:
    motion, pressures = traces_of(record)
    assert motion.y_title == "heave [in]"
    response = {curve.name: curve.y for curve in motion.curves}["response"]
    np.testing.assert_array_equal(response, record["platform_pose"][:, 2] / units.INCH)
    leg = int(pressures.y_title.split()[1])
    cap = pressures.curves[0]
    assert cap.name == "cap"
    np.testing.assert_array_equal(cap.y, record["cap_pressure"][:, leg - 1] / units.PSI)


def test_runs_beside_each_other_show_one_leg(record: Record) -> None:
    """The one that moves most in any of them, here the other leg of the second."""
    leg = busiest_leg(record)
    pressures = record["cap_pressure"].copy()
    pressures[:, (leg + 1) % 6] = 2.0 * pressures[:, leg]
    other = {"cap_pressure": pressures}
    assert busiest_leg(record, other) == (leg + 1) % 6 == busiest_leg(other, record)
    _, shown = traces_of(record, leg=(leg + 1) % 6)
    assert shown.y_title == f"leg {(leg + 1) % 6 + 1} [psi]"


def test_the_video_command_takes_the_folder_of_a_run(record: Record, tmp_path: Path) -> None:
    record.save(tmp_path / "run" / "record.parquet")
    out = tmp_path / "run.html"
    cmf("video", tmp_path / "run", "--file", out)
    law = str(record.metadata["law"]).replace("_", " ")
    assert f"<title>run: {law}</title>" in out.read_text(encoding="utf-8")


def test_panels_stand_in_columns_each_with_its_own_cursor() -> None:
    """Six panels in two columns: at a time two cursors in a row of pixels, a column apart."""
    time = np.linspace(0.0, 1.0, 50)
    sine, cosine = np.sin(time), np.cos(time)
    curves = Curve("a", time, sine, "#0072b2"), Curve("b", time, cosine, "#d55e00")
    panels = [Panel(f"q{i} [m]", curves) for i in range(6)]
    picture = Strip(panels, 600, 300, (0.0, 1.0)).picture(0.5)
    assert picture.shape == (300, 600, 3)
    red = (picture == (200, 30, 30)).all(axis=2)
    drawn = np.flatnonzero(red.any(axis=1))
    assert np.count_nonzero(np.diff(drawn) > 1) == 2  # three rows of panels
    cursors = np.flatnonzero(red[drawn[0]])
    assert cursors.size == 4  # two pixels each
    assert cursors[0] < 300 < cursors[-1]


@pytest.mark.parametrize("count", [5, 7, 8])
def test_a_last_column_may_be_shorter(count: int) -> None:
    """A cursor, two pixels wide, a panel, each panel in the strip's own rows and column."""
    time = np.linspace(0.0, 1.0, 50)
    panels = [Panel(f"q{i} [m]", (Curve("a", time, time, "#0072b2"),)) for i in range(count)]
    red = (Strip(panels, 600, 300, (0.0, 1.0)).picture(0.5) == (200, 30, 30)).all(axis=2)
    starts = np.diff(red.astype(int), axis=0, prepend=0) == 1
    assert starts.sum() == 2 * count


def test_limits_hold_what_is_drawn() -> None:
    """Also of no pressure, and of a span between two samples, where lines are drawn."""
    time = np.linspace(0.0, 1.0, 11)
    still = Panel("cap [psi]", (Curve("cap", time, 0.0 * time, "k"),), from_zero=True)
    sinking = Panel("cap [psi]", (Curve("cap", time, time - 3.0, "k"),), from_zero=True)
    rising = Panel("heave [in]", (Curve("response", time, time, "k"),))
    for panel, span, least, most in (
        *((still, (0.0, 1.0), 0.0, 0.0), (sinking, (0.0, 1.0), -3.0, 0.0)),
        (rising, (0.42, 0.44), 0.42, 0.44),
    ):
        low, high = limits_of([panel], span)
        assert low <= least and most <= high and low < high
    with pytest.raises(InputError, match="panels: none is given"):
        Strip([], 100, 100, (0.0, 1.0))


def test_an_open_loop_shows_its_response(record: Record, tmp_path: Path) -> None:
    valves = ValveCommands(np.tile([0.1, 0.1, -0.05, -0.05, -0.05, -0.05], (64, 1)))
    opened = Run(plant=Hexapod(), law=None, source=valves, electronics=None).record()
    motion, _ = traces_of(opened)
    (response,) = motion.curves
    column = DOFS.index(motion.y_title.split()[0])
    scale = units.factor(dof_unit(column))
    np.testing.assert_array_equal(response.y, opened["platform_pose"][:, column] / scale)
    with pytest.raises(InputError, match=r"traces: \[0, 2\] panels; allowed: as many"):
        film([record, opened], tmp_path / "x.html", traces=[(), traces_of(opened)])


def test_traces_grow_from_left_to_right(record: Record) -> None:
    strip = Strip(traces_of(record), 400, 200, (0.0, 0.5))
    ink = [(255 - strip.picture(time)[..., :2].astype(int)).sum() for time in (0.0, 0.25, 0.5)]
    assert ink[0] < ink[1] < ink[2]
    cursors = [np.argmax((strip.picture(t) == (200, 30, 30)).all(2)[60]) for t in (0.1, 0.3)]
    assert cursors[0] < cursors[1]


@pytest.mark.slow
def test_the_video_command_compares_laws(tmp_path: Path) -> None:
    path = scenario.save_scenario(quick(duration=0.2), tmp_path / "short.toml")
    out = tmp_path / "laws.mp4"
    small = ("--fps", "5", "--width", "160", "--height", "100")
    cmf("video", path, "--laws", "velocity,original", "--file", out, *small)
    assert frames_of(out)[0].shape == (290, 320, 3)


@pytest.mark.parametrize("option", ["--fps", "--width", "--height"])
def test_a_page_takes_nothing_that_it_would_not_follow(option: str, tmp_path: Path) -> None:
    page = tmp_path / "x.html"
    said = cmf("video", "push", "--file", page, option, "40", code=2)
    assert f"{option[2:]}: a page is as large as its window" in said and not page.exists()


# OpenGL


def test_without_display_or_choice_egl_and_then_osmesa_are_tried(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[str] = []

    def works(backend: str) -> bool:
        tried.append(backend)
        return backend == "osmesa"

    monkeypatch.setattr(stage, "_works", works)
    monkeypatch.setattr(stage.sys, "platform", "linux")
    assert choose_backend({}) == "osmesa"
    assert tried == ["egl", "osmesa"]
    assert choose_backend({"DISPLAY": ":0"}) == "glfw"
    assert choose_backend({"MUJOCO_GL": "egl", "DISPLAY": ":0"}) == "egl"
    with pytest.raises(ValueError, match="MUJOCO_GL: 'vulkan' is not one of egl, osmesa, glfw"):
        choose_backend({"MUJOCO_GL": "vulkan"})
    monkeypatch.setattr(stage, "_works", lambda backend: False)
    with pytest.raises(ValueError, match="install libegl1 and libgl1-mesa-dri .*libosmesa6"):
        choose_backend({})


def test_the_backend_of_the_tests_is_found_by_trying() -> None:
    assert stage._works(choose_backend())
    assert not stage._works("no_such_backend")


@pytest.mark.slow
def test_a_stage_draws_what_the_model_does() -> None:
    model = hexapod_spec("rfd").compile()
    with FilmStage(model, 160, 100) as drawn:
        level = drawn.picture(model.qpos0)
        again = drawn.picture(model.qpos0)
        raised = model.qpos0.copy()
        raised[2] += 0.5
        np.testing.assert_array_equal(level, again)
        assert np.abs(drawn.picture(raised).astype(int) - level.astype(int)).max() > 60
    assert model.vis.global_.offwidth == 1920  # the caller's model is left alone


# Looks


@pytest.mark.parametrize("cab", ["gfd", "rfd", "ifd"])
def test_looks_do_not_act(cab: str) -> None:
    """The machine without a single shape, light, camera or picture moves bit for bit the same."""
    full, bare = hexapod_spec(cab), hexapod_spec(cab)
    for kind in (bare.geoms, bare.lights, bare.cameras):
        for element in list(kind):
            bare.delete(element)
    states = []
    for spec in (full, bare):
        model = spec.compile()
        data = mujoco.MjData(model)
        rng = np.random.default_rng(5)
        for _ in range(40):
            data.ctrl[:] = 3.2e4 + rng.uniform(-2e4, 2e4, 6)
            mujoco.mj_step(model, data)
        states.append((model.nq, model.body_inertia, model.body_mass, data.qpos, data.sensordata))
    assert full.compile().ngeom > 100
    for one, other in zip(*states, strict=True):
        np.testing.assert_array_equal(one, other)
