"""Diagnosis while a trial runs: evidence by gait cycle, in a process that reads the growing file."""
