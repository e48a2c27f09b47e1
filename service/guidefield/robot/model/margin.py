"""The margin: what bodies keep from each other beyond what is asked for, wherever this house chooses."""

from __future__ import annotations

MARGIN = 2e-3
"""Beyond the distance that is asked for [m].

It is 200 times the certificate's floor, and next to nothing of free space. With it the certificate refuses a tenth as
many of a tree's shortened paths as without; they are 0.5 % longer (`tools/bench connect`). For shortcuts end where they
graze something, and samples overlook corners. Steps of the guided planner keep it, motions among moving obstacles, the
lowest floor of the optimiser, and links that the stated rest has in contact.
"""
