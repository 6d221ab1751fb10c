"""The bytes of a trial: MCAP records and chunks, CDR messages, recovery of damaged files."""
