"""The Digital Control Unit (DCU): host frames in, platform demand at 2048 Hz out.

    host (<= 80 Hz) -> [ acceptance -> buffer -> interpolation -> limit -> transport line ] -> DCL

In the frame loop, for each frame that has arrived `receive(dcu, state, sequence, time, values)`,
then `play.step(dcu, state, demand)`. Compiled, without allocation; knows neither plant nor sockets.
"""
