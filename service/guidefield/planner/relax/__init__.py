"""Paths taken to the middle of the free space."""
