"""Surfaces, hulls, charged points and fitted capsules: for links and obstacles alike.

Positions are in the frame of the body that is given, unless a docstring says otherwise.
"""
