"""The pilot: aircraft, cueing, motion at the station, perception."""
