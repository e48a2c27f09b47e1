"""Scenes from the files that people have of their cell: meshes, clouds, MoveIt, URDF, SDF and MJCF."""
