"""Collision tests at sixteen configurations and along motions, of swept capsules too, distances by GJK, and tables."""
