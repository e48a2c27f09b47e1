"""Signed distances of points from bodies, insides, and the trees of boxes, triangles and points that they search."""
