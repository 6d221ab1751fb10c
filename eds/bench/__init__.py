"""Wire of a declared bench: COB-IDs, PDO plans, node set-up, bus load."""
