"""Bench models at work: identify or fit one, simulate with it, diagnose with it, keep it in the logbook."""
