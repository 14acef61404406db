"""The Digital Control Unit (DCU): host frames in, platform demand at 2048 Hz out.

    host (<= 80 Hz) -> [ acceptance -> buffer -> interpolation -> limit -> transport line ] -> DCL

In the frame loop `receive` takes each frame that has arrived, then `play.step` writes the demand.
"""
