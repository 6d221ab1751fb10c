"""Virtual time, the wire, its faults, and the bench that joins plant and devices."""
