"""Render the machine with one of its cabs, or the excavator, to PNG, or its motion to MP4 or GIF.

Off-screen: without a display EGL and then OSMesa are tried, unless MUJOCO_GL names one.
"""

import argparse
from pathlib import Path

import matplotlib.image
import mujoco

from cmf_mj.facility.scenario import load_scenario, run_scenario
from cmf_mj.machine import models
from cmf_mj.plant.hexapod import hexapod_model
from cmf_mj.show.film import FilmSettings, film
from cmf_mj.show.stage import FilmStage

_MOTION = FilmSettings(fps=10, width=400, height=270, strip=150)
"""Small enough for a README."""


def main() -> None:
    """Parse the arguments and write the picture."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cab", choices=models.CABS, default="gfd", help="default: %(default)s")
    parser.add_argument("--excavator", action="store_true", help="draw the excavator instead")
    parser.add_argument(
        "--motion", metavar="SCENARIO", help="film this scenario instead, shipped or a TOML file"
    )
    parser.add_argument("--seconds", type=float, default=6.0, help="of it; default: %(default)s")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE")
    parser.add_argument("--camera", default="overview", help="overview, side or front (hexapod)")
    parser.add_argument("--width", type=int, default=1280, help="pixels, at most 1920")
    parser.add_argument("--height", type=int, default=720, help="pixels, at most 1080")
    arguments = parser.parse_args()

    if arguments.motion is not None:
        shown = load_scenario(arguments.motion)
        changes = {"cab": arguments.cab, "duration": arguments.seconds, "record_every": 8}
        record = run_scenario(shown.model_copy(update=changes))
        film([record], arguments.out, _MOTION, titles=[shown.title])
    else:
        if arguments.excavator:
            model = mujoco.MjModel.from_xml_path(str(models.model_path("excavator.xml")))
        else:
            model = hexapod_model(arguments.cab)
        data = mujoco.MjData(model)
        with FilmStage(model, arguments.width, arguments.height, arguments.camera) as stage:
            pixels = stage.picture(data.qpos)
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        matplotlib.image.imsave(arguments.out, pixels)
    print(arguments.out)


if __name__ == "__main__":
    main()
