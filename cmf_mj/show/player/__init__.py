"""Runs as one page to play in any browser, in three dimensions, without server or network."""
