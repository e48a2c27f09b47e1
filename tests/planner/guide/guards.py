"""A guard that lets the tip be anywhere."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.guide.tip_constraint import TipGuard
from guidefield.read_only import read_only

ANYWHERE = TipGuard(
    origin=np.zeros(3),
    axes=np.eye(2, 3),
    inward=np.eye(2),
    offsets=np.zeros(2),
    corners=np.zeros((1, 2)),
    inset=0.0,
    farthest=np.inf,
    depth=-np.inf,
)
read_only(*ANYWHERE[:5])
