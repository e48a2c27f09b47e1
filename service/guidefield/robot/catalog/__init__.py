"""Robots by name: those that come with guidefield, files, and what clients send."""
