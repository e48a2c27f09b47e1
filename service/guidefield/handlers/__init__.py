"""One function per request: domain calls in order, no network. `agreement.py` alone writes a file, about a bug."""
