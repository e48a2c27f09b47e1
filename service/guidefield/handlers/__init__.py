"""One function per request: domain calls in order, no network. Files: `agreement.py` on bugs, and geometry's cache."""
