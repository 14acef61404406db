"""A host drives the facility over UDP in real time, as a simulator would.

The host sends platform poses at 80 Hz; the facility's DCU makes a demand at 2048 Hz of them. Both
run here, on loopback; yours would send the same datagrams from its own machine.
"""

import threading

import cmf_mj
from cmf_mj import signals
from cmf_mj.facility.host.stream import from_command
from cmf_mj.facility.host.udp import UdpReceiver, send_stream
from cmf_mj.facility.operation import serve

SECONDS = 6.0

flight = from_command(signals.sine("heave", 0.1, 0.5, cycles=2), rate=80.0)
with UdpReceiver() as receiver:
    host = threading.Thread(target=send_stream, args=(flight, *receiver.address))

    def started(done: float) -> None:
        """Let the host send when the facility's clock starts."""
        if done == 0.0:
            host.start()

    operation = serve(cmf_mj.Hexapod(), "velocity", receiver.ring, SECONDS, progress=started)
    host.join()
heave = operation.record["platform_pose"][:, 2]
counts = operation.counts
print(f"frames accepted: {counts['accepted']} of {flight.time.size}, {counts['late']} late")
print(f"heave from {heave.min():.3f} to {heave.max():.3f} m")
