"""Robots as data: URDFs and cards.

`robot/library.py` finds each `<name>.card.json` here; a card may name a URDF of example-robot-data instead of
one of these. Names are the public API's: a file may be added, but not renamed. An added name hides robots that clients
stored by it.
"""
