"""Forward models that a fit runs for many sets of constants at once: the bench's force path, rigs of other kinds."""
