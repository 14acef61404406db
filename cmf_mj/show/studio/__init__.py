"""The studio: the machine in a web page, driven by the closed loop in real time."""
