"""Runs and modes as pictures: off-screen films, and MuJoCo's viewer on a live run."""
