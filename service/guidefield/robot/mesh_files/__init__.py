"""Mesh files of every kind that is read, as triangles: one reader for collision, pictures and lists.

Files are untrusted. `reading.py` says what a further kind needs.
"""
