"""Connections of configurations: trees, and what is done with the paths that they find."""
