"""The compiled control cycle: one numba call in place of the events of one complete cycle."""
