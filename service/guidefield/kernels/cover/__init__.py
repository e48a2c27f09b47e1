"""Covers found once a robot: balls that contain a body, balls inside of it, how tight they are."""
