"""PDOs of a device: mapping, parameters, reception and transmission."""
