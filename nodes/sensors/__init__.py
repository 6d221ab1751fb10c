"""CiA 404 tension sensors and the CiA 406 joint encoder: scaling, filter, sampled channel."""
