"""Records of runs, the facility's CSV files at 128 Hz, and UFF 58."""
