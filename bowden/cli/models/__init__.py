"""Commands on bench models: identify, fit, simulate, diagnose, verify, and the logbook of a bench."""
