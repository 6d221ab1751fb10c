"""Replay of a recorded trial onto a bus, the controller or a plant."""
