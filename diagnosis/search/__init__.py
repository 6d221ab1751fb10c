"""The search for effects that explain what the reference does not."""
