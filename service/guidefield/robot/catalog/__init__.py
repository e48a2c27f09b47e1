"""Robots by name: those that come with guidefield, files, and what clients send.

Names are the public API's. `library.py` stays light, for those that store robots.
"""
