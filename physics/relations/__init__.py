"""Relations that should hold between measured signals; fast forms of the plant's laws for the diagnosis."""
