"""Many requests at once, over local workers or over a cluster: resumable, every one answered."""
