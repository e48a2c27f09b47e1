"""Examine this machine for faults that guidefield suffers from, each with advice."""
