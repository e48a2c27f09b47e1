"""Curves through waypoints, and their timing."""
