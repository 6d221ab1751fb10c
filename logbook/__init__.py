"""Logbook of one bench: trials, sessions, bench constants per session, changes with their dates, maintenance.

Modules, lowest first: `database` (one SQLite file), `change_cause` (trials to diagnose for a change, kept diagnosis),
`maintenance` (parts and what a note resets), `bench_state` (state by the estimator's sequence of sessions),
`bench_page` (one HTML page), `logbook_tables`.  The room does not read trials: its callers do, and fit them.
"""
