"""The plant: hydraulic actuators driving mechanics that MuJoCo integrates."""
