"""The referee: a second certifier, written from its pages (docs/referee.md, docs/certificate.md) alone.

It imports nothing of the rest of guidefield, so that a bug there can't hide here: keep it so, also where that means the
same function twice.
"""
