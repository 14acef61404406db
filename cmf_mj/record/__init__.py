"""Records of runs, and the facility's CSV files at 128 Hz."""
