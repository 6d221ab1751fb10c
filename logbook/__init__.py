"""Logbook of one bench: trials, sessions, bench constants per session, changes with their dates, maintenance.

Modules, lowest first: `database` (one SQLite file), `session_model` (bench constants and session deviations of many
sessions), `change_search` (evidence of a step or a ramp, forecast), `bench_page` (one HTML page). The room processes
numbers only: its callers read and fit the trials.
"""
