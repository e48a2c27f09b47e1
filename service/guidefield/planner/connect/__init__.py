"""Connections of configurations: trees, and what is done with the paths that they find.

Paths are free at samples: what is made of them is certified above, in `planner/`.
"""
