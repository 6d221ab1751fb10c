"""Commands that run, replay, convert, edit and report trials."""
