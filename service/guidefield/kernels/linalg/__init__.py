"""Small systems of equations, solved where they stand."""
