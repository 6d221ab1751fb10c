"""Benches and their buses: opening a bus, reading the configuration, examining the computer, any CANopen node."""
