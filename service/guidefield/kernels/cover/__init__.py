"""Covers of bodies, found once a robot or mesh: balls that contain a body or lie in it, cuts, depths; clean meshes."""
