"""Report of a diagnosis: HTML page, and export of plots (PNG) and tables (CSV)."""
