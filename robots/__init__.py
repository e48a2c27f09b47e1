"""Robots as data: URDFs and cards."""
