"""Guide planes: found, reached and crossed by descending the field."""
