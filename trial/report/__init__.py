"""The report of a trial: one HTML page that needs no network."""
