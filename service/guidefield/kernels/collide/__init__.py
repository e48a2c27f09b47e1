"""Collision tests at sixteen configurations and along motions, distances by GJK, and the tables of bodies for both."""
