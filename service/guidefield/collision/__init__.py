"""Collision: a robot among obstacles, exact distances, tables for SIMD batches, and bounds on motions for proofs.

`batch` stands on the world, which may not import it (service/contracts.toml).
"""
