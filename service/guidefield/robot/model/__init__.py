"""The robot as a value: joints, limits, shapes, pairs, rest.

It isn't changed once it is loaded. Pairs that it leaves out are never tested.
"""
