"""Logbook of one bench: trials, sessions, bench constants per session, changes since when, maintenance.

Modules, lowest first: `database` (one SQLite file), `session_model` (bench constants and session deviations of many
sessions), `change_search` (evidence of a step or a ramp, forecast), `bench_page` (one HTML page).  The room knows
numbers only: trials are read and fitted by those who call it.
"""
