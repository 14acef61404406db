"""The loop, the laws and the hydraulics as machine code for hosts without Python."""
