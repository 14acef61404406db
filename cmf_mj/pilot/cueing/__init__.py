"""Motion cueing: from the motion of an aircraft's pilot to frames of a host."""
