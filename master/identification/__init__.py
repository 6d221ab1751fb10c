"""Identification: the paper's experiments over the bus, and the fits that turn them into a calibration."""
