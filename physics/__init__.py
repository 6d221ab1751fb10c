"""The bench's physics: each law once, the plant's step, and the catalogue of effects.

The rule of this room: pure laws in SI and radians; it knows no frames, no files and no bus.
"""
