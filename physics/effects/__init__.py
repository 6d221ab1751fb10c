"""The catalogue of effects: what may be wrong with a bench, each effect declared once."""
