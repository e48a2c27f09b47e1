"""Surfaces, hulls, charged points and fitted capsules: for links and obstacles alike."""
