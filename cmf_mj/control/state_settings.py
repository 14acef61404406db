"""Times, rates and tolerances of the operating states, from `states.toml`."""

from pathlib import Path
from typing import Annotated

from cmf_mj.core.quantity import Quantity, positive_in
from cmf_mj.core.settings import Loader, Settings

_Time = Annotated[Quantity, positive_in("s")]
_Length = Annotated[Quantity, positive_in("in", "m")]


class StateSettings(Settings):
    """Times, rates and tolerances of the operating states."""

    raise_time: _Time  #: Least fade from the stops to neutral.
    engage_time: _Time  #: Least fade to the host's demand.
    hold_time: _Time
    """Least fade to hold, where the legs would otherwise come to rest beyond the stroke."""
    return_time: _Time  #: Least fade to the stops.
    fault_time: _Time  #: Least fade to the stops after a fault.
    stop_time: _Time  #: Least time in which a difference in velocity is taken out.
    valve_time: _Time  #: Time in which the valve command is faded in or out.
    speed: Annotated[Quantity, positive_in("in/s", "m/s")]  #: Largest leg speed of a fade.
    acceleration: Annotated[Quantity, positive_in("g", "m/s^2", "in/s^2")]
    """Largest leg acceleration of a fade, and of a stop."""
    settled_tolerance: _Length
    """Distance from the settled position within which a leg without command lies on the stops."""
    arrival_tolerance: _Length
    """Distance from neutral or the settled position within which a leg has followed there."""
    arrival_timeout: _Time  #: Time after the end of raise or return in which the legs must arrive.


load_state_settings = Loader(StateSettings, Path(__file__).with_name("states.toml"))
"""Loads the settings of the operating states."""
