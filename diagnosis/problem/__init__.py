"""Estimation problem of a diagnosis: checked prediction equations, reference, weights, candidate effects, and fits."""
