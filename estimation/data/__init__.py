"""Measured data of a diagnosis: reading of trials and tables, checks for contradictions, comparison with models."""
