"""Sweeps: many trials of simulated benches, run by several processes, collected in one table."""
