"""Mesh files of every kind that is read, as triangles: one reader for whatever is judged, drawn or listed."""
