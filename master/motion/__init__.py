"""Motions of the bench: homing, jogging, the gait and the scripted experiments."""
