"""One MCAP file is one experiment: recorded without loss, read in bulk.

Start reading in `trial.read` (`trial.open`), `trial.record` (the recorder) and `trial.signals` (names and units).
"""

from trial.read import Trial, open
from trial.record import Recorder, RecordingError
from trial.signals import COLUMNS, SIGNALS, UNITS

__all__ = ["COLUMNS", "SIGNALS", "UNITS", "Recorder", "RecordingError", "Trial", "open"]
