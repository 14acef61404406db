"""Films of the modes: true periods, whole files."""

from functools import partial
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from cmf_mj import Hexapod
from cmf_mj.analysis.modes import largest_stroke
from cmf_mj.cli.common import app
from cmf_mj.core import units
from cmf_mj.machine.geometry import DOFS
from cmf_mj.show import film
from cmf_mj.show.film import FilmSettings, caption_of, swing_film
from tests.analysis.test_modes_swing import LEANING, legs_of

SMALL = FilmSettings(fps=6, speed=0.05, width=64, height=50)


@pytest.fixture(scope="module")
def plant() -> Hexapod:
    return Hexapod("gfd")


class Watched(film.FilmStage):
    """A stage that keeps the configurations it draws."""

    seen: list[NDArray[np.float64]] = []

    def picture(self, qpos: NDArray[np.float64]) -> NDArray[np.uint8]:
        self.seen.append(qpos.copy())
        return super().picture(qpos)


@pytest.mark.slow
def test_the_film_shows_each_mode_with_its_own_period(
    plant: Hexapod, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frequency on the screen, by fitting a sine to what was drawn: the mode's times the speed."""
    monkeypatch.setattr(film, "FilmStage", Watched)
    Watched.seen = []
    modes, chosen = plant.hydraulic_modes(), SMALL._replace(fps=20, speed=0.2)
    reported: list[tuple[int, int]] = []
    show = partial(swing_film, progress=lambda *done: reported.append(done))
    path = show(plant, modes, tmp_path / "m.mp4", chosen)
    count = round(1.0 / (modes.frequency_hz[0] * 0.2) * 20)
    assert reported == [(number, count) for number in range(1, count + 1)]
    assert len(Watched.seen) == 6 * count
    time = np.arange(count) / 20.0  # of the screen
    tried = np.linspace(0.5, 5.0, 4501)
    for mode in range(6):
        legs = legs_of(plant, np.array(Watched.seen[mode::6]))
        leg = legs[:, np.ptp(legs, axis=0).argmax()]
        assert np.abs(leg).max() <= 12.0 * units.INCH + 1e-9
        waves = np.sin(2.0 * np.pi * tried[:, None] * time)
        left = [np.sum((leg - w * (w @ leg) / (w @ w)) ** 2) for w in waves]
        assert tried[np.argmin(left)] == pytest.approx(0.2 * modes.frequency_hz[mode], abs=1e-3)
    with av.open(str(path)) as container:
        assert container.streams.video[0].frames == count


@pytest.mark.slow
def test_an_mp4_is_whole_and_says_what_it_shows(plant: Hexapod, tmp_path: Path) -> None:
    modes = plant.hydraulic_modes(LEANING)
    path = swing_film(plant, modes, tmp_path / "m.mp4", SMALL._replace(speed=0.07))
    with av.open(str(path)) as container:
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        assert container.streams.video[0].average_rate == 6
    assert len(pictures) == round(1.0 / (modes.frequency_hz[0] * 0.07) * 6)
    height, width, _ = pictures[0].shape
    assert (width, height) == (3 * SMALL.width, 2 * SMALL.height)
    moved = np.max([np.abs(p.astype(int) - pictures[0]) for p in pictures], axis=0)
    panels = [moved[:, 64 * i : 64 * (i + 1)].max() for i in range(3)]
    assert min(panels) > 60
    assert [p.name for p in tmp_path.iterdir()] == ["m.mp4"]

    most = min(12.0 * units.INCH, largest_stroke(plant, modes, 5))
    assert most < 12.0 * units.INCH
    caption, mass = caption_of(modes, 5, most), units.from_si("lbm", modes.leg_mass[5])
    leading = 100.0 * modes.share[:, 5].max()
    first, second = (DOFS[k] for k in np.argsort(-modes.share[:, 5])[:2])
    moves = f"{first} with {second}: {modes.frequency_hz[5]:.2f} Hz"
    assert caption.startswith(f"{moves}, {mass:.0f} lbm a leg")
    assert f" {leading:.0f} %, legs ±{units.from_si('in', most):.1f} in" in caption


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"width": 63}, "width: 63 pixels must be even"),
        ({"height": 4000}, "height: 4000 pixels must be between 16 and 1080"),
        ({"speed": 0.5}, "speed: 0.5 with 6 frames a second leaves the fastest at 14.1 Hz"),
    ],
)
def test_what_a_film_of_modes_cannot_do_is_named(
    change: dict[str, Any], said: str, plant: Hexapod, tmp_path: Path
) -> None:
    look = SMALL._replace(**change)
    with pytest.raises(ValueError) as refused:
        swing_film(plant, plant.hydraulic_modes(), tmp_path / "x.mp4", look)
    assert said in str(refused.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_command_films_the_pose(tmp_path: Path) -> None:
    looks = ["--fps", "6", "--speed", "0.09", "--width", "64", "--height", "50"]
    arguments = ["video", "modes", "--cab", "ifd", "--pose", "0,0,-20,0,10,0", *looks]
    film = tmp_path / "film.mp4"
    done = CliRunner().invoke(app, [*arguments, "--file", str(film)])
    assert done.exit_code == 0, done.output
    with av.open(str(film)) as container:
        stream = container.streams.video[0]
        assert stream.width == 192 and stream.frames >= 2
    refused = CliRunner().invoke(app, [*arguments, "--file", str(film.with_suffix(".avi"))])
    assert refused.exit_code == 2
    assert "film.avi must end in .mp4 or .html" in refused.output
