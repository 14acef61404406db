"""An aircraft as the host: JSBSim flown by script, and recorded flights that need no JSBSim."""
