"""Mesh files: read as triangles, for collision, pictures and lists; checked and renamed if a client sent them.

Files are untrusted. `reading.py` says what a further kind needs.
"""
