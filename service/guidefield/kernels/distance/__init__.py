"""Distances of points from bodies."""
