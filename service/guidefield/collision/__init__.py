"""Collision: a robot among obstacles, exact distances, tables for SIMD batches, and bounds on motions for proofs."""
