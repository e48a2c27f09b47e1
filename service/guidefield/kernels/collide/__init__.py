"""Collision tests of bodies at sixteen configurations, and along motions."""
