"""Where the experiments' chance comes from: seeds, and nothing else."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator


def generator(seed: int, name: str = "") -> Generator:
    """A generator of its own for each seed and name."""
    return np.random.default_rng([seed, *name.encode()])
