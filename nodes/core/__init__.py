"""The CiA 301 device core: any CANopen device, given a dictionary and an application, in frames and nanoseconds.

The rule of this room: sans-IO.  Frames and times go in as arguments, frames come out of `Device.outbox`;
nothing here reads a clock, opens a bus or starts a thread.
"""
