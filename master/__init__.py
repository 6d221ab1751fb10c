"""The master: from a silent bus to disabled drives, with a controller in the SYNC cycle.

It promises that a stop uses nothing that failed, that a cycle without its inputs makes no step, and that END never
reaches a controller.  It knows a bus, a clock and a calibration, and not whether a bench or a simulation answers.
Start reading in `master.cycle.exchange` (one cycle), `master.cycle.run_safely` (around it) and `master.network.link`.
"""
