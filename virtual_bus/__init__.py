"""Virtual time, the wire, its faults, and the bench that joins plant and devices.

The same options give the same frames at the same nanoseconds in any process; nothing reads a clock, sleeps or starts
a thread.
Start reading in `virtual_bus.bus` (python-can's side), `virtual_bus.bench` (what is on it) and `virtual_bus.wire`.
"""
