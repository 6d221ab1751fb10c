"""The CAN wire: bit times, arbitration, error confinement and faults, and the stations that are joined to it."""
