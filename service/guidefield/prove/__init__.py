"""The certificate: whole motions judged, between their samples too."""
