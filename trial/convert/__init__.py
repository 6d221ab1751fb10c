"""Conversion between trials and other formats: CSV, Parquet, CAN logs, foreign MCAP, python-can."""
