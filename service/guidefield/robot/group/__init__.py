"""The joints that a request plans for, where they stand and how they move."""
