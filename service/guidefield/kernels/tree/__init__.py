"""RRT-Connect on lanes."""
