"""Search for effects that explain the residual of the reference model."""
