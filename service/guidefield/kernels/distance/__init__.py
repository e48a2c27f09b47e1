"""Signed distances of points from bodies, and the trees of boxes, triangles and points that they search."""
