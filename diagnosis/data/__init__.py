"""Measured data: columns read once, checked for contradictions, and what bus and converter did to them."""
