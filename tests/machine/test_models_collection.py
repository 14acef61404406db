"""The folder of models as a collection of MuJoCo models would take it.

What a collection checks: the files it wants beside a model, one way to write MJCF, that every scene
steps without a warning; and that machine, cab and hall can be had apart.
"""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mjcf_style import WIDTH, canonical
from PIL import Image

from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.machine import kinematics, models
from cmf_mj.machine.cab import load_cab
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.plant import Plant

FOLDER = models.directory()
FILES = sorted(str(path.relative_to(FOLDER)) for path in FOLDER.rglob("*.xml"))
LEGS = range(1, 7)


def spec_of(name: str) -> mujoco.MjSpec:
    return mujoco.MjSpec.from_file(str(FOLDER / name))


@pytest.fixture(scope="module")
def machine() -> mujoco.MjModel:
    return spec_of("cmf_hexapod.xml").compile()


@pytest.fixture(scope="module")
def scene() -> mujoco.MjModel:
    return spec_of("scene.xml").compile()


def names(model: mujoco.MjModel, kind: mujoco.mjtObj, count: int) -> list[str]:
    return [mujoco.mj_id2name(model, kind, i) or "" for i in range(count)]


# Files


def test_a_readme_a_licence_a_changelog_and_a_picture_lie_beside_the_models() -> None:
    readme = (FOLDER / "README.md").read_text("utf-8")
    assert readme.splitlines()[0].endswith(" Description (MJCF)")
    assert re.search(r"MuJoCo \d+\.\d+ or later", readme)
    for name in (*FILES, "cmf_hexapod.png", "LICENSE", "CHANGELOG.md"):
        assert name in readme, f"README.md does not name {name}"
    assert (FOLDER / "LICENSE").read_text() == (Path(__file__).parents[2] / "LICENSE").read_text()
    changes = (FOLDER / "CHANGELOG.md").read_text("utf-8")
    assert re.search(r"^## \[\d{4}-\d\d-\d\d\]$", changes, re.MULTILINE)


def test_the_picture_shows_something() -> None:
    with Image.open(FOLDER / "cmf_hexapod.png") as picture:
        assert picture.format == "PNG" and min(picture.size) >= 400
        pixels = np.asarray(picture.convert("RGB"), dtype=float)
    assert pixels.reshape(-1, 3).std(axis=0).min() > 15.0


def test_no_model_needs_a_file_from_elsewhere() -> None:
    for name in FILES:
        for element in ElementTree.parse(FOLDER / name).getroot().iter():
            if "file" in element.attrib:
                assert (FOLDER / name).parent.joinpath(element.attrib["file"]).is_file()
                assert ".." not in element.attrib["file"]


# Style


@pytest.mark.parametrize("name", FILES)
def test_it_is_written_in_the_one_way(name: str) -> None:
    text = (FOLDER / name).read_text("utf-8")
    assert text == canonical(text)
    long = [line for line in text.splitlines() if len(line) > WIDTH]
    assert all("vertex=" in line for line in long), "only one attribute alone may be that long"


@pytest.mark.parametrize("name", FILES)
def test_names_are_words_in_lower_case(name: str) -> None:
    root = ElementTree.parse(FOLDER / name).getroot()
    stem = Path(name).stem
    assert root.get("model") in (stem, "cmf_hexapod scene", f"cmf_{stem}")
    given = [e.get("name", "") for e in root.iter() if e.tag != "model" and e.get("name")]
    assert all(re.fullmatch(r"[a-z][a-z0-9_]*", one) for one in given), given


@pytest.mark.parametrize("name", FILES)
def test_everything_that_moves_or_measures_has_a_name(name: str) -> None:
    model = spec_of(name).compile()
    kinds = mujoco.mjtObj
    for kind, count in (
        (kinds.mjOBJ_BODY, model.nbody),
        (kinds.mjOBJ_JOINT, model.njnt),
        (kinds.mjOBJ_SITE, model.nsite),
        (kinds.mjOBJ_ACTUATOR, model.nu),
        (kinds.mjOBJ_SENSOR, model.nsensor),
        (kinds.mjOBJ_EQUALITY, model.neq),
        (kinds.mjOBJ_CAMERA, model.ncam),
        (kinds.mjOBJ_LIGHT, model.nlight),
    ):
        assert all(names(model, kind, count))
    assert names(model, kinds.mjOBJ_KEY, model.nkey) in ([], ["home"])


# Mechanics


@pytest.mark.parametrize("name", FILES)
def test_it_loads_alone_and_steps_without_a_warning(name: str) -> None:
    """A tenth of a second, with controls of up to 1 that fill their range evenly."""
    model = spec_of(name).compile()
    data = mujoco.MjData(model)
    for step in range(1, int(0.1 / model.opt.timestep)):
        data.ctrl[:] = [2.0 * mujoco.mju_Halton(step, j + 2) - 1.0 for j in range(model.nu)]
        mujoco.mj_step(model, data)
    assert not data.warning.number.any()
    assert np.isfinite(data.qacc).all()


@pytest.mark.parametrize("name", FILES)
def test_no_geom_has_mass_or_touches(name: str) -> None:
    spec = spec_of(name)
    assert all(geom.mass == 0.0 and not (geom.contype or geom.conaffinity) for geom in spec.geoms)
    moving = [body for body in spec.bodies if body.name != "world" and name != "cabs/none.xml"]
    assert all(body.explicitinertial or body.name == "cab/cab" for body in moving)


def test_the_machine_is_alone(machine: mujoco.MjModel, scene: mujoco.MjModel) -> None:
    """No hall, no light, no camera, no cab; all it draws is visual geometry, group 2."""
    assert machine.ncam == machine.nlight == machine.nkey == 0
    assert not (machine.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any()
    assert (machine.geom_group == 2).all()
    assert not (machine.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any()
    assert machine.body("cab/cab").mass[0] == 0.0
    assert machine.body_mass.sum() == load_cab("gfd").platform.mass.si + 6 * 450.0
    hall = scene.geom_group == 1
    assert (scene.geom_bodyid[hall] == 0).all() and hall.sum() == 9


def test_the_scene_is_the_machine_with_hall_and_cab(
    machine: mujoco.MjModel, scene: mujoco.MjModel
) -> None:
    assert scene.body("cab/cab").mass[0] == load_cab("gfd").mass.si
    assert scene.ngeom == machine.ngeom + (scene.geom_group == 1).sum() + (
        spec_of("cabs/gfd.xml").compile().ngeom
    )
    kinds = mujoco.mjtObj
    for kind, field in ((kinds.mjOBJ_BODY, "nbody"), (kinds.mjOBJ_JOINT, "njnt")):
        found = [names(model, kind, getattr(model, field)) for model in (machine, scene)]
        assert found[0] == found[1]
    for field in ("body_pos", "body_quat", "jnt_range", "jnt_axis", "eq_solref", "eq_solimp"):
        np.testing.assert_array_equal(getattr(machine, field), getattr(scene, field))
    assert machine.opt.timestep == scene.opt.timestep
    assert machine.opt.disableflags == scene.opt.disableflags


def test_the_machine_attaches_elsewhere_twice(machine: mujoco.MjModel) -> None:
    """Under an empty model, each where it is put, with gimbals closed and its own motions."""
    scene, child = mujoco.MjSpec(), spec_of("cmf_hexapod.xml")
    scene.copy_during_attach = True
    scene.option.timestep, scene.option.gravity = machine.opt.timestep, machine.opt.gravity
    places = {"left/": [0.0, 6.0, 3.98], "right/": [1.0, -6.0, 3.98]}
    for prefix, place in places.items():
        scene.attach(child, prefix=prefix, frame=scene.worldbody.add_frame(pos=place))
    pair = scene.compile()
    assert (pair.nq, pair.nv, pair.nu) == (2 * machine.nq, 2 * machine.nv, 2 * machine.nu)
    assert pair.neq == 2 * machine.neq and pair.ngeom == 2 * machine.ngeom
    alone, both = mujoco.MjData(machine), mujoco.MjData(pair)
    alone.ctrl[:], both.ctrl[:] = 1e4, 1e4
    for model, data in ((machine, alone), (pair, both)):
        for _ in range(64):
            mujoco.mj_step(model, data)
    for prefix, place in places.items():
        moved = both.body(f"{prefix}platform").xpos - place
        np.testing.assert_allclose(moved, alone.body("platform").xpos, rtol=0.0, atol=1e-9)
        for leg in LEGS:
            assert np.abs(both.sensor(f"{prefix}gimbal_error_{leg}").data).max() < 1e-6


@pytest.mark.parametrize("cab", models.CABS)
def test_a_cab_adds_the_legs_its_weight(machine: mujoco.MjModel, cab: str) -> None:
    """Statics are linear: the forces of the machine alone, and J' f = w of the cab's weight w."""
    alone, mounted, part = Plant(machine, payload=["platform"]), Hexapod(cab), load_cab(cab)
    mounted.place(np.zeros(6))
    weight = part.mass.si * STANDARD_GRAVITY
    x, y, _ = part.centre_of_mass.si
    wrench = weight * np.array([0.0, 0.0, -1.0, y, x, 0.0])  # z is down, y to the right
    added = np.linalg.solve(kinematics.pose_jacobian(np.zeros(6)).T, wrench)
    np.testing.assert_allclose(mounted.static_load(), alone.static_load() + added, atol=1e-6)


@pytest.mark.parametrize("cab", models.CABS)
def test_naming_another_cab_in_the_scene_mounts_it(cab: str, tmp_path: Path) -> None:
    """As README.md says: one line, and no Python."""
    text = (FOLDER / "scene.xml").read_text("utf-8").replace("cabs/gfd.xml", f"cabs/{cab}.xml")
    (tmp_path / "cabs").mkdir()
    for name in ("cmf_hexapod.xml", "cabs/none.xml", f"cabs/{cab}.xml"):
        (tmp_path / name).write_bytes((FOLDER / name).read_bytes())
    (tmp_path / "scene.xml").write_text(text)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    assert model.body("cab/cab").mass[0] == load_cab(cab).mass.si
    assert model.site("cab/crew").bodyid[0] == model.body("cab/cab").id
