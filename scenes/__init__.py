"""Scenes as data, in the schema of the wire."""
