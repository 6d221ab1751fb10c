"""Unattended repair of a bench's model: record, diagnose, experiment, extend, prove in the loop, keep or undo."""
