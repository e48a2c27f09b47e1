"""The certificate: continuous collision detection along whole motions, by motion bounds, and proofs of it.

What is called free rests on it: bounds may be larger, never smaller. The referee shares no code with it.
"""
