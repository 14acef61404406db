"""What a motion base is: geometry, kinematics, gravity in its legs, motion limits, model files."""
