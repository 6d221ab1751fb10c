"""Logbook of one bench: trials, sessions, bench constants per session, changes with their dates, maintenance.

Modules, lowest first:

    database         one SQLite file
    change_cause     trials to diagnose for a change, and the diagnosis that is kept
    bench_state      state of the bench by the estimator's sequence of sessions
    session_fits     reference posterior, and the sums of each trial under it
    maintenance      parts, and constants that a note resets
    bench_page       one HTML page
    logbook_tables   CSV and Parquet

Start reading in `database`, then `bench_state`.
"""
