"""The control cycle: exchange of PDOs at SYNC, monitoring, drive states and the safe stop."""
