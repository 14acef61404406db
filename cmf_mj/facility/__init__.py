"""The facility: the closed loop in compiled frames, runs, scenarios, hosts."""
