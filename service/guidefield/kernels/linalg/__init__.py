"""Linear algebra: a banded system with a border, systems of a few rows, products, principal axes."""
