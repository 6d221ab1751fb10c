"""Strides of the paper's knee that differ, as arrays and as a file: smooth departures, drawn by a seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from physics.reference import paper_angle
from physics.stride_walk import Stride

AWAY_RAD = 0.03


def strides(count: int, seed: int = 0) -> list[Stride]:
    """Return strides about (1) whose departures are sines of one to three turns, `AWAY_RAD` rms."""
    random = np.random.default_rng(seed)
    percent = np.arange(100.0)
    middle = paper_angle()[0][:-1][::10]
    found = []
    for _ in range(count):
        turns = 2.0 * np.pi * percent / 100.0
        away = sum(random.normal(0.0, AWAY_RAD / np.sqrt(3.0)) * np.sqrt(2.0)
                   * np.sin(k * turns + random.uniform(0.0, 2.0 * np.pi)) for k in (1, 2, 3))
        found.append(Stride(percent, middle + away, float("nan")))
    return found


def written(path: Path, count: int = 5, seed: int = 0) -> Path:
    """Write strides as CSV, numbered by a column."""
    rows = [f"{i},{at:g},{np.degrees(angle):.4f}" for i, one in enumerate(strides(count, seed))
            for at, angle in zip(one.percent, one.angle_rad, strict=True)]
    path.write_text("\n".join(["stride,gait_percent,knee_angle_deg", *rows]) + "\n", encoding="utf-8")
    return path
