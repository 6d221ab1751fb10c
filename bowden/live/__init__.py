"""Live view: a trial or a running bus in a Foxglove viewer."""
