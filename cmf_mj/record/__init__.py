"""Records of runs, and recordings of others by column maps."""
