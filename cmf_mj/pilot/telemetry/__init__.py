"""Telemetry of other simulators: its formats, and whether it is what it says."""
