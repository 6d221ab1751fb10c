"""Commands on a bench: its bus, its nodes, its configuration, and the procedures before and between trials."""
