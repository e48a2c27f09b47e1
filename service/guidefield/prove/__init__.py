"""The certificate: continuous collision detection along whole motions, by motion bounds, and proofs of it."""
