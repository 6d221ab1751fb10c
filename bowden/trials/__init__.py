"""Trials: run one on a bus, record a bus, read one back, with the experiment and the provenance that it carries."""
