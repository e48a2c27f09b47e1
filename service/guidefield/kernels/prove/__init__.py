"""Certificates of motions, and the smallest distances between bodies at configurations and along motions."""
