"""A machine from its recordings: what to record, and what the recordings say of its numbers."""
