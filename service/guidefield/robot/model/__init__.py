"""The robot as a value: joints, limits, shapes, pairs, rest."""
