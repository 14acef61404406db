"""Render the machine with one of its cabs, or the excavator, to a PNG file, off-screen.

Off-screen rendering needs an OpenGL back end; without a display set MUJOCO_GL=egl or
MUJOCO_GL=osmesa.
"""

import argparse
from pathlib import Path

import matplotlib.image
import mujoco

from cmf_mj import models
from cmf_mj.plant.hexapod import hexapod_spec


def main() -> None:
    """Parse the arguments and write the picture."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cab", choices=models.CABS, default="gfd", help="default: %(default)s")
    parser.add_argument("--excavator", action="store_true", help="draw the excavator instead")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.png")
    parser.add_argument("--camera", default="overview", help="overview, side or front (hexapod)")
    parser.add_argument("--width", type=int, default=1280, help="pixels, at most 1920")
    parser.add_argument("--height", type=int, default=720, help="pixels, at most 1080")
    arguments = parser.parse_args()

    if arguments.excavator:
        model = mujoco.MjModel.from_xml_path(str(models.excavator_path()))
    else:
        model = hexapod_spec(arguments.cab).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, height=arguments.height, width=arguments.width) as renderer:
        renderer.update_scene(data, camera=arguments.camera)
        pixels = renderer.render()
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    matplotlib.image.imsave(arguments.out, pixels)
    print(arguments.out)


if __name__ == "__main__":
    main()
