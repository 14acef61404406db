"""The loop and the laws as machine code for hosts without Python."""
