"""Scenes as data, in the schema of the wire.

`stores/scenes.py` finds each `<name>.json` here. Names are the public API's: a file may be added, but not renamed.
Clients can't store scenes by an added name any more.
"""
