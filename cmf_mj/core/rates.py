"""The facility's clock: the control frame, which is also the rate of demands and records."""

RATE = 2048
"""Control frames a second [Hz]; the facility's DCL runs at 2048 Hz."""

SLOWEST_RATE, FASTEST_RATE = 200, 10_000
"""Control rates that a machine may have [Hz]."""

FRAME = 1.0 / RATE
"""Control frame [s]; exact in binary."""

MOST_FRAMES = 2**31
"""Control frames of the longest run: whole numbers of 32 bits count them."""

LONGEST = MOST_FRAMES * FRAME
"""Its length [s]: 2^20 s, twelve days."""
