"""What the certificate computes before Coal is asked: kernels of its own, that nothing which plans shares."""
