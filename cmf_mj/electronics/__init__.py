"""Between plant and control law: sensors, converters, servo electronics."""
