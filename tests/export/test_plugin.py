"""The excavator's cylinders as a plugin of MuJoCo, beside `drive`."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from cmf_mj import drive
from cmf_mj.core.errors import InputError
from cmf_mj.export.plugin import export_plugin
from cmf_mj.machine import models
from tests.plant.test_attach_excavator import CYLINDERS, excavator

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> mujoco.MjModel:
    """Plain MJCF, compiled by MuJoCo with the plugin loaded."""
    out = tmp_path_factory.mktemp("plugin")
    export_plugin(
        Path(models.model_path("excavator.xml")),
        CYLINDERS,
        models.model_path("excavator_hydraulics.toml"),
        out,
    )
    mujoco.mj_loadPluginLibrary(str(out / "libcmf_cylinders.so"))
    return mujoco.MjModel.from_xml_path(str(out / "excavator.xml"))


def commands() -> np.ndarray:
    return 0.1 * np.sin(np.arange(2048)[:, None] / [150.0, 200.0, 250.0])


def stepped(model: mujoco.MjModel, data: mujoco.MjData, valves: np.ndarray) -> np.ndarray:
    """Generalised positions at the beginning of each step."""
    positions = np.empty((valves.shape[0], model.nq))
    for step, command in enumerate(valves):
        positions[step] = data.qpos
        data.ctrl[:] = command
        mujoco.mj_step(model, data)
    return positions


def test_mj_step_makes_the_record_of_drive(model: mujoco.MjModel) -> None:
    """The same bits: the same hydraulics, between MuJoCo's own stages."""
    record = drive(excavator(), commands())
    found = stepped(model, mujoco.MjData(model), commands())
    assert found.tobytes() == record["generalised_position"].tobytes()
    assert np.ptp(found, axis=0).max() > 0.01


def test_a_state_that_is_set_goes_on_with_the_same_bits(model: mujoco.MjModel) -> None:
    data, valves = mujoco.MjData(model), commands()
    stepped(model, data, valves[:1000])
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    once = stepped(model, data, valves[1000:])
    other = mujoco.MjData(model)
    mujoco.mj_setState(model, other, state, kind)
    assert stepped(model, other, valves[1000:]).tobytes() == once.tobytes()


def test_rollouts_on_threads_are_the_steps(model: mujoco.MjModel) -> None:
    valves = np.stack([commands()[:400], -commands()[:400]])
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    begin = np.empty((2, mujoco.mj_stateSize(model, kind)))
    mujoco.mj_getState(model, mujoco.MjData(model), begin[0], kind)
    begin[1] = begin[0]
    states, _ = rollout.rollout(model, [mujoco.MjData(model) for _ in range(2)], begin, valves)
    for case in range(2):
        data = mujoco.MjData(model)
        stepped(model, data, valves[case])
        assert states[case, -1, 1 : 1 + model.nq].tobytes() == data.qpos.tobytes()


def test_another_step_is_refused(model: mujoco.MjModel) -> None:
    model.opt.timestep *= 2.0
    try:
        with pytest.raises(Exception, match="plugin->init failed|cmf.cylinders"):
            mujoco.MjData(model)
    finally:
        model.opt.timestep /= 2.0


def test_the_model_itself_is_not_overwritten(tmp_path: Path) -> None:
    """A model in the folder it is exported to, its file named like it."""
    own = tmp_path / "excavator.xml"
    own.write_bytes(models.model_path("excavator.xml").read_bytes())
    before = own.read_bytes()
    with pytest.raises(InputError, match=r"out: .* is refused: excavator\.xml there is the model"):
        export_plugin(own, CYLINDERS, models.model_path("excavator_hydraulics.toml"), tmp_path)
    assert own.read_bytes() == before and list(tmp_path.iterdir()) == [own]


def test_what_cannot_be_written_is_refused_before_anything_is(tmp_path: Path) -> None:
    """A model of several files, whose parts would not be found; a file where the folder goes."""
    oil, parts = models.model_path("excavator_hydraulics.toml"), tmp_path / "parts.xml"
    parts.write_bytes(models.model_path("excavator.xml").read_bytes())
    whole = tmp_path / "whole.xml"
    whole.write_text(f'<mujoco model="whole"><include file="{parts}"/></mujoco>')
    with pytest.raises(InputError, match=r"model: .* includes other files; allowed: the whole"):
        export_plugin(whole, CYLINDERS, oil, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match=r"out: .* is refused: .* is not a folder"):
        export_plugin(parts, CYLINDERS, oil, whole)
