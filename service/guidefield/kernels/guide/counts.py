"""What the kernels of a guide count: one row of whole numbers, with these columns."""

from __future__ import annotations

from guidefield.kernels.jit.signatures import INDICES_OUT

EVALUATIONS, JUDGED, STEPS, ROUNDS, REFUSED, COUNTS = range(6)
"""Evaluations of U or of its forces; motions judged; steps of descents; rounds towards a plane; ends of the motion that
was refused in the last of them, 2 or 0; then how many columns there are."""

COUNTS_OUT = INDICES_OUT
"""A row of them, shape (COUNTS,)."""
