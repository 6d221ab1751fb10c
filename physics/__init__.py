"""The bench's physics: each equation once, the plant's step, and the catalogue of effects.

Pure functions in SI and radians, without frames, files or buses.

Start reading in `physics.laws` (the equations), `physics.plant` (the simulation) and `physics.effects.catalogue`.
"""

from pathlib import Path

from parameters import compile_cache

compile_cache.prepare(Path(__file__).parent)
