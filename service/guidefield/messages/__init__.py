"""The vocabulary of the wire and of files: requests, replies, scenes, and their encoding.

The light client has this folder, too: nothing here imports NumPy, or a room that it hasn't (`rooms` in pyproject.toml).
Docstrings of messages are their descriptions in docs/wire.schema.json: after a change, `tools/wire_page` makes it anew.
"""
