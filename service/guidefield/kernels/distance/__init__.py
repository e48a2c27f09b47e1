"""How far points are from bodies."""
