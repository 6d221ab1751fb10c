"""Given measured data: what the simulation gets wrong, why, and what mending it gains.

The rule of this room: it reads the laws and the catalogue of `physics` and names no effect in its own code;
whatever it says carries an interval, the data that said it were not those it was fitted on, and what these
data cannot tell is said as such.
"""
