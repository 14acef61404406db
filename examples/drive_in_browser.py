"""Drive the machine in a web page: move it, change its law, push it, let something fail.

`pip install 'cmf-mj[browser]'`, run this file, and open the address that it prints. The session
runs in step with the clock; what the page asks for takes effect in the next control frame, and
`done_run` returns all of it as a scenario that `cmf run` repeats bit for bit.
"""

import argparse
import queue
import time

import mujoco
import viser
from mjviser import ViserMujocoScene

from cmf_mj import CmfError, law_names
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.facility.changes import change_of
from cmf_mj.facility.scenario import scenario_of
from cmf_mj.facility.signal_session import SignalSession
from cmf_mj.machine.geometry import DOFS, dof_unit
from cmf_mj.machine.motion_limits import relative_travel
from cmf_mj.plant.events import KINDS, default_event
from cmf_mj.plant.hexapod import hexapod_model

parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
parser.add_argument("--machine", default="cmf", help="name or TOML file")
parser.add_argument("--seconds", type=float, default=float("inf"), help="length of the session")
arguments = parser.parse_args()

run = scenario_of({"machine": arguments.machine, "duration": "open", "record_every": 16}, "page")
session = SignalSession(run, kept_seconds=60.0)
server = viser.ViserServer(host="127.0.0.1", port=8048, verbose=False)
model = hexapod_model(run.loaded_cab)
data = mujoco.MjData(model)
scene = ViserMujocoScene(server, model, num_envs=1)
scene.camera_tracking_enabled = False


@server.on_client_connect
def look_at_machine(client: viser.ClientHandle) -> None:
    """Show the whole machine from the right front."""
    x, y, z = (float(model.stat.extent * share) for share in (1.6, -1.6, 0.3))
    client.camera.position, client.camera.look_at = (x, y, z), (0.0, 0.0, -0.1 * x)


gui, changes = server.gui, queue.SimpleQueue()
status = gui.add_markdown("starting")
first_law, cab = session.law_in_force.name, run.loaded_cab
laws = tuple(dict.fromkeys((first_law, *law_names("all"))))  # a machine may have its own
law = gui.add_dropdown("law", laws, initial_value=first_law)
dof = gui.add_dropdown("degree of freedom", DOFS, initial_value="heave")
size = round(2.0 * relative_travel(cab.machine, "heave"), 2)
amplitude = gui.add_number("amplitude [in or deg]", size, min=0.0, max=40.0, step=0.05)
frequency = gui.add_number("frequency [Hz]", 0.5, min=0.05, max=10.0, step=0.05)
weight = STANDARD_GRAVITY * cab.payload.mass
push = gui.add_slider("push to the right [% of the weight]", 0.0, 75.0, 1.0, 0.0)
failure = gui.add_dropdown("failure", KINDS, initial_value="pump_lost")
move, rest, fail = (gui.add_button(name) for name in ("move", "rest", "fail now"))


def sine() -> dict[str, object]:
    """The demand as a scenario file has it."""
    amplitude_with_unit = [amplitude.value, dof_unit(dof.value)]
    shape = {"frequency": frequency.value, "cycles": round(3000 * frequency.value)}
    return {"kind": "sine", "dof": dof.value, "amplitude": amplitude_with_unit, **shape}


def failed() -> dict[str, object]:
    """What fails; of leg 1 where it is a leg's."""
    event = default_event(failure.value, at=0.0)
    return {"kind": event.kind} | ({} if event.leg is None else {"leg": event.leg})


law.on_update(lambda _: changes.put({"law": law.value}))
push.on_update(lambda _: changes.put({"push": {"force": [0.0, -0.01 * weight * push.value, 0.0]}}))
move.on_click(lambda _: changes.put({"signal": [sine()]}))
rest.on_click(lambda _: changes.put({"signal": []}))
fail.on_click(lambda _: changes.put({"failure": [failed()]}))
print(f"http://127.0.0.1:{server.get_port()}", flush=True)

changes.put({"signal": [sine()]})
clock = time.monotonic()
try:
    while (now := session.frame / session.rate) < arguments.seconds:
        while not changes.empty():
            try:
                session.apply(change_of(changes.get()))
            except CmfError as refused:
                print(refused)
        behind = time.monotonic() - clock - now
        clock += max(behind - 0.25, 0.0)  # a slow computer shows slow motion
        session.run(max(int(min(behind, 0.25) * session.rate), 0))
        data.qpos[:] = session.plant.data.qpos
        mujoco.mj_kinematics(model, data)
        scene.update_from_mjdata(data)
        fault = "" if session.fault is None else f", tripped: {session.fault.name}"
        pressure = session.dynamics.state.pressure.max() / 1e5
        name = session.law_in_force.name
        status.content = f"{now:.1f} s, {name}, oil at most {pressure:.0f} bar{fault}"
        time.sleep(1 / 30)
except CmfError as ended:  # the machine has left its physical bounds
    print(ended)
record = session.record()
heave = record["platform_pose"][:, 2]
print(f"ran {record.time[-1]:.1f} s; heave from {heave.min():.3f} to {heave.max():.3f} m")
server.stop()
